"""The report's charts as inline SVG; image coordinates are pixels, (0, 0) the centre of the first one."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.quality.view_coverage import CELLS

Array = NDArray[np.float64]

BLUE, RED, AMBER, GREY, LINE = "#1668b0", "#c8372d", "#e39a1c", "#66727f", "#dde3e9"
COLORS = {"left": BLUE, "right": "#b0541a", "projector": "#6a3fa0"}


def vector_scale(misfits: Sequence[Array], width: int) -> float:
    """A round magnification of the residuals, with which most are some hundredths of the image's width."""
    lengths = np.concatenate([np.linalg.norm(misfit, axis=1) for misfit in misfits] or [np.empty(0)])
    if not len(lengths) or not (long := float(np.quantile(lengths, 0.95))) > 0:
        return 1.0
    raw = 0.05 * width / long
    power = 10.0 ** np.floor(np.log10(raw))
    return float(power * max(n for n in (1, 2, 5) if n * power <= raw * (1 + 1e-9)))


def view_image(
    size: tuple[int, int], jpeg: bytes, used: Array, misfit: Array, left_out: Array, *, scale: float, color: str
) -> str:
    """A view with its marks and their residuals, ``scale`` times enlarged.

    Args:
        size: (width, height) of the image, pixels; jpeg: the image, of any size.
        used, misfit: (n, 2) marks and measured minus predicted; left_out: (m, 2) marks that were not used.
    """
    width, height = size
    thin = width / 300
    href = f"data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}" if jpeg else ""
    image = f'<image href="{href}" x="-0.5" y="-0.5" width="{width}" height="{height}"/>' if jpeg else ""
    ends = used - scale * misfit
    dots = "".join(f"M{u:.1f} {v:.1f}h0" for u, v in used)
    lines = "".join(f"M{u:.1f} {v:.1f}L{x:.1f} {y:.1f}" for (u, v), (x, y) in zip(used, ends, strict=True))
    reach = 2.5 * thin
    crosses = "".join(
        f"M{u - reach:.1f} {v - reach:.1f}l{2 * reach:.1f} {2 * reach:.1f}m0 {-2 * reach:.1f}"
        f"l{-2 * reach:.1f} {2 * reach:.1f}"
        for u, v in left_out
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-0.5 -0.5 {width} {height}" role="img">'
        f'<rect x="-0.5" y="-0.5" width="{width}" height="{height}" fill="#10151b"/>{image}'
        f'<path d="{dots}" stroke="{color}" stroke-width="{2.6 * thin:.2f}" stroke-linecap="round" fill="none"/>'
        f'<path d="{lines}" stroke="#ff4d3d" stroke-width="{1.1 * thin:.2f}" fill="none"/>'
        f'<path d="{crosses}" stroke="{AMBER}" stroke-width="{1.3 * thin:.2f}" fill="none"/></svg>'
    )


def coverage_map(size: tuple[int, int], pixels: Array, misfit: Array, *, scale: float, color: str) -> str:
    """Positions of the marks of all views, and the mean residual of each cell as an arrow."""
    width, height = size
    columns, rows = (2 * count for count in CELLS)
    cell = width / columns
    column = np.clip((pixels[:, 0] / cell).astype(int), 0, columns - 1)
    row = np.clip((pixels[:, 1] / (height / rows)).astype(int), 0, rows - 1)
    counts = np.zeros((rows, columns))
    np.add.at(counts, (row, column), 1)
    sums = np.zeros((rows, columns, 2))
    np.add.at(sums, (row, column), misfit)
    most = max(1.0, float(np.quantile(counts, 0.9)))
    thin = width / 500
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="-1 -1 {width + 2} {height + 2}" role="img">',
        f'<rect x="0" y="0" width="{width}" height="{height}" fill="#fff" stroke="{GREY}" stroke-width="{thin:.2f}"/>',
    ]
    tall = height / rows
    for r in range(rows):
        for c in range(columns):
            bounds = f'x="{c * cell:.1f}" y="{r * tall:.1f}" width="{cell:.1f}" height="{tall:.1f}"'
            if counts[r, c]:
                opacity = 0.08 + 0.3 * min(1.0, counts[r, c] / most)
                out.append(f'<rect {bounds} fill="{color}" opacity="{opacity:.2f}"/>')
            else:
                out.append(f'<rect {bounds} fill="#f1d9d6"/>')
    out.append(
        f'<path d="{"".join(f"M{u:.0f} {v:.0f}h0" for u, v in pixels)}" stroke="{color}" '
        f'stroke-width="{2 * thin:.2f}" stroke-linecap="round" opacity="0.7"/>'
    )
    arrows = ""
    for r, c in zip(*np.nonzero(counts >= 3), strict=True):
        u, v = (c + 0.5) * cell, (r + 0.5) * tall
        du, dv = scale * sums[r, c] / counts[r, c]
        arrows += f"M{u:.1f} {v:.1f}l{du:.1f} {dv:.1f}"
        out.append(f'<circle cx="{u:.1f}" cy="{v:.1f}" r="{2.2 * thin:.1f}" fill="{RED}"/>')
    out.append(f'<path d="{arrows}" stroke="{RED}" stroke-width="{1.8 * thin:.2f}" fill="none"/></svg>')
    return "".join(out)


def histogram(misfit: Array, sigma_px: float, *, color: str) -> str:
    """Residuals in u (filled) and v (line) with the normal distribution of the same width."""
    width, height, foot = 420.0, 210.0, 26.0
    reach = max(3.5 * sigma_px, 1e-6)
    edges = np.linspace(-reach, reach, 36)
    tops = [np.histogram(misfit[:, axis], edges)[0] for axis in (0, 1)]
    step = edges[1] - edges[0]
    middle = np.linspace(-reach, reach, 121)
    bell = len(misfit) * step * np.exp(-(middle**2) / (2 * sigma_px**2)) / (np.sqrt(2 * np.pi) * sigma_px)
    top = 1.08 * max(float(max(t.max() for t in tops)), float(bell.max()), 1.0)

    def x(value: float) -> float:
        return width * (value + reach) / (2 * reach)

    def y(value: float) -> float:
        return (height - foot) * (1 - value / top)

    bars = "".join(
        f"M{x(edges[n]):.1f} {y(0):.1f}V{y(t):.1f}H{x(edges[n + 1]):.1f}V{y(0):.1f}Z"
        for n, t in enumerate(tops[0])
        if t
    )
    steps = f"M{x(edges[0]):.1f} {y(0):.1f}" + "".join(
        f"V{y(t):.1f}H{x(edges[n + 1]):.1f}" for n, t in enumerate(tops[1])
    )
    curve = "M" + "L".join(f"{x(float(m)):.1f} {y(float(b)):.1f}" for m, b in zip(middle, bell, strict=True))
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width:g} {height:g}" role="img">',
        f'<path d="{bars}" fill="{color}" opacity="0.35"/>',
        f'<path d="{steps}" fill="none" stroke="{color}" stroke-width="1.4"/>',
        f'<path d="{curve}" fill="none" stroke="{RED}" stroke-width="1.4" stroke-dasharray="5 3"/>',
        f'<path d="M0 {y(0):.1f}H{width:g}" stroke="{GREY}"/>',
    ]
    for value in _ticks(0.9 * reach):
        out.append(f'<path d="M{x(value):.1f} {y(0):.1f}v4" stroke="{GREY}"/>')
        out.append(_text(x(value), height - 6, f"{value:g}", "middle"))
    return "".join([*out, "</svg>"])


def view_bars(names: Sequence[str], series: Sequence[tuple[str, str, Sequence[float]]], unit: str) -> str:
    """Grouped bars for every view; series of (label, colour, values), NaN for a view without a value."""
    values = np.array([values for _, _, values in series], dtype=np.float64)
    top = 1.15 * (float(np.nanmax(values)) if np.isfinite(values).any() else 1.0)
    width, chart, foot, margin = 1080.0, 200.0, 74.0, 52.0
    pitch = (width - margin) / max(1, len(names))
    each = min(26.0, 0.8 * pitch / max(1, len(series)))
    out = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 -8 {width:g} {chart + foot + 8:g}" role="img">']
    for value in _ticks(top):
        if value < 0:
            continue
        y = chart * (1 - value / top)
        out.append(f'<path d="M{margin:g} {y:.1f}H{width:g}" stroke="{LINE}"/>')
        out.append(_text(margin - 6, y + 4, f"{value:g}", "end"))
    for number, name in enumerate(names):
        centre = margin + (number + 0.5) * pitch
        for k, (_, color, _) in enumerate(series):
            value = values[k, number]
            if np.isfinite(value):
                x, tall = centre + (k - len(series) / 2) * each, chart * value / top
                out.append(
                    f'<rect x="{x:.1f}" y="{chart - tall:.1f}" width="{each - 2:.1f}" height="{tall:.1f}" '
                    f'fill="{color}" opacity="0.85"/>'
                )
        short = name if len(name) < 13 else f"{name[:5]}…{name[-6:]}"
        out.append(
            f'<text transform="translate({centre + 4:.1f} {chart + 12:g}) rotate(-40)" font-size="11" '
            f'text-anchor="end" fill="{GREY}">{escape(short)}</text>'
        )
    at = margin
    for label, color, _ in series:
        out.append(f'<rect x="{at:g}" y="{chart + foot - 12:g}" width="11" height="11" fill="{color}"/>')
        out.append(_text(at + 16, chart + foot - 2, f"{label}, {unit}", "start"))
        at += 40 + 7.0 * (len(label) + len(unit))
    return "".join([*out, "</svg>"])


def _ticks(reach: float) -> list[float]:
    """Round values from -reach to reach, about seven."""
    raw = 2 * reach / 7
    power = 10.0 ** np.floor(np.log10(raw))
    step = float(power * min(n for n in (1, 2, 5, 10) if n * power >= raw))
    most = int(reach / step)
    return [round(n * step, 10) for n in range(-most, most + 1)]


def _text(x: float, y: float, text: str, anchor: str) -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" font-size="11" text-anchor="{anchor}" fill="{GREY}">{escape(text)}</text>'
