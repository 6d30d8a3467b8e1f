"""Tables of docs/start/box-of-parts.md: expected noise by field of view and distance, focal lengths, depth of field.

``python -m tools.docs.noise`` writes them between the marks of the page; a test compares them with the page, and the
model with the standard deviations of the pipeline on a rendered plane.

The model: sigma_Z = (Z / b) (p / 2 pi) sqrt(2) sigma_phi, with sigma_phi = sqrt(2/3) sigma_I / B, raised by the
crosstalk correction and lowered by the window in which the phase is fitted; Z distance, b baseline, p fringe period on
the object, B amplitude, sigma_I image noise, from the simulator's standard light and sensor.
"""

from __future__ import annotations

import re
from functools import partial
from math import exp, pi, sqrt

import numpy as np

from pipeline.common.settings import Settings
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from tools.docs.pages import DOCS

PAGE = DOCS / "start" / "box-of-parts.md"
WHITE, GREY = 0.9, 0.18
BAYER = 2.0
"""Ratio of the median sigma of Bayer and three-chip sensors, measured: docs/explanation/modes.md."""
_FIELDS_MM = (100, 200, 400, 800, 1500)
_RATIOS = (2.0, 2.8, 5.0)
_SENSORS = (("1/2.9 inch", 5.0), ("1/1.8 inch", 7.2), ("2/3 inch", 8.8), ("1 inch", 12.8))
"""Typical widths of the active area, mm."""


def phase_noise(albedo: float = WHITE, *, optics: Optics | None = None, periods: float = 96.0) -> float:
    """Standard deviation of the fitted phase of a surface facing the rig, rad.

    Args:
        albedo: of the surface; optics: light and sensor; periods: of the fringe on the standard projector.
    """
    optics, layout = optics or Optics(), RigLayout()
    fringe, crosstalk = layout.pattern(), optics.true_crosstalk()[0]
    on_sensor = layout.focal_px * layout.projector_size[0] / layout.projector_focal_px / periods
    blur = _blur(optics.defocus_px * periods / layout.projector_size[0]) * _blur(optics.psf_px / on_sensor)
    gain = optics.gain(0) * albedo
    mean = gain * (fringe.mean * float(crosstalk.sum()) / 3 + 255 * optics.ambient)
    variance = mean * 255 / optics.full_well_e + optics.read_noise_dn**2 + 1 / 12
    phase = np.linspace(0, 2 * pi, 36, endpoint=False)
    sines = np.sin(phase[:, None] + np.array([-2 * pi / 3, 0, 2 * pi / 3]))
    corrected = float(((sines @ np.linalg.inv(crosstalk)) ** 2).sum(axis=1).mean())  # 3/2 without crosstalk
    return 2 / 3 * sqrt(variance * corrected * _window()) / (gain * fringe.amplitude * blur)


def _blur(periods: float) -> float:
    """Factor on the amplitude by a blur of this standard deviation."""
    return exp(-2 * (pi * periods) ** 2)


def _window() -> float:
    """Noise variance after the window fit, as a share of that of one pixel."""
    radius, sigma = Settings().window(mosaic=False)
    row = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma) ** 2)
    weights = np.outer(row, row)
    return float((weights**2).sum() / weights.sum() ** 2)


def sigma_mm(field_mm: float, ratio: float, *, periods: float = 96.0, albedo: float = WHITE) -> float:
    """Expected standard deviation of a point along its ray, mm.

    Args:
        field_mm: width of the field of view; ratio: distance / baseline; periods: over that width.
    """
    return ratio * field_mm / periods / (2 * pi) * sqrt(2) * phase_noise(albedo, periods=periods)


def tables() -> dict[str, str]:
    """The tables by the names of their marks."""
    noise = ["| field of view | " + " | ".join(f"distance {r:g} baselines" for r in _RATIOS) + " |"]
    noise.append("| --- |" + " --: |" * len(_RATIOS))
    for field in _FIELDS_MM:
        noise.append(f"| {field} mm | " + " | ".join(f"{1e3 * sigma_mm(field, r):.0f} um" for r in _RATIOS) + " |")
    base = sigma_mm(400, 2.8)
    factors = [
        "| change | factor |",
        "| --- | --: |",
        f"| dark grey surface (18 % instead of 90 %) | {sigma_mm(400, 2.8, albedo=GREY) / base:.1f} |",
        f"| Bayer instead of three-chip sensor (measured) | {BAYER:.1f} |",
        f"| 64 instead of 96 periods | {sigma_mm(400, 2.8, periods=64) / base:.1f} |",
        f"| 128 instead of 96 periods | {sigma_mm(400, 2.8, periods=128) / base:.1f} |",
        f"| a small sensor, {_FULL_WELL} electrons instead of 10,000 | {_small() / phase_noise():.1f} |",
    ]
    lenses = [
        "| sensor (width) | " + " | ".join(f"{r:g} fields away" for r in (2, 3, 4)) + " |",
        "| --- |" + " --: |" * 3,
    ]
    lenses += [
        f"| {name} ({w:g} mm) | " + " | ".join(f"{w * r:.0f} mm" for r in (2, 3, 4)) + " |" for name, w in _SENSORS
    ]
    return {"noise": "\n".join(noise), "factors": "\n".join(factors), "lenses": "\n".join(lenses)}


_FULL_WELL = "2,500"


def _small() -> float:
    return phase_noise(optics=Optics(full_well_e=2_500.0))


def _with_table(table: str, found: re.Match[str]) -> str:
    return f"{found[1]}\n{table}\n\n{found[2]}"


def with_tables(markdown: str) -> str:
    """The page with its tables."""
    for name, table in tables().items():
        block = re.compile(rf"(<!-- computed: {name} -->\n).*?(<!-- end -->)", re.DOTALL)
        markdown = block.sub(partial(_with_table, table), markdown)
    return markdown


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
