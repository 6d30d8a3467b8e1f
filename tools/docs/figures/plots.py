"""Figures of the method: pattern, phase, orders, cloud, error; and the image of the README."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from tools.docs.figures.measure import Measurement
from tools.docs.figures.render import View, render

mpl.use("Agg")
mpl.rcParams |= {"font.size": 9, "svg.fonttype": "none", "svg.hashsalt": "fringed", "axes.titlesize": 10}
_WIDTH, _DPI = 7.6, 120
_INK = "#1d2733"
METHOD, HERO = ("pattern", "phase", "orders", "error", "cloud"), ("hero",)


def draw(measurement: Measurement, folder: Path, names: tuple[str, ...] = METHOD) -> list[Path]:
    """Draw the named figures of one measurement."""
    drawings = {"pattern": pattern, "phase": phase, "orders": orders, "error": error, "cloud": cloud, "hero": hero}
    return [_saved(drawings[name](measurement), folder / f"{name}.png") for name in names]


def _saved(figure: Any, path: Path) -> Path:
    figure.savefig(path, dpi=_DPI, metadata={"Software": None})
    plt.close(figure)
    return path


def pattern(m: Measurement) -> Any:
    """A part of the projected image, and the light of its channels."""
    columns = int(4 * m.pattern.size[0] / m.pattern.periods)
    figure, (above, below) = plt.subplots(2, 1, figsize=(_WIDTH, 3.2), height_ratios=(1, 1.6), layout="constrained")
    image = m.pattern.image(None)
    above.imshow(image[: columns // 5, :columns], interpolation="nearest", aspect="auto")
    above.set(xticks=[], yticks=[], title="projected image, first four periods")
    for channel, name in enumerate(("red", "green", "blue")):
        below.step(np.arange(columns), image[0, :columns, channel], where="mid", color=f"tab:{name}", label=name)
    below.set(xlim=(0, columns - 1), ylim=(0, 320), xlabel="projector column", ylabel="light")
    below.legend(loc="upper right", ncols=3, frameon=True)
    return figure


def _map(values: NDArray[Any], title: str, label: str, image: NDArray[Any] | None = None, **options: Any) -> Any:
    figure, axes = plt.subplots(figsize=(_WIDTH, 5.2), layout="constrained")
    axes.set_facecolor("#e9ecef")
    if image is not None:
        axes.imshow(image)
    shown = axes.imshow(values, interpolation="nearest", **options)
    axes.set(xticks=[], yticks=[], title=title)
    figure.colorbar(shown, ax=axes, label=label, shrink=0.85)
    return figure


def phase(m: Measurement) -> Any:
    """Wrapped phase where the fringes are visible."""
    visible = np.where(m.cloud.modulation[0] >= 5, m.phase, np.nan)
    return _map(visible, "wrapped phase, left image", "rad", cmap="twilight", vmin=-np.pi, vmax=np.pi)


def orders(m: Measurement) -> Any:
    """Fringe order of every measured pixel."""
    order = np.where(m.cloud.order >= 0, m.cloud.order, np.nan).astype(float)
    return _map(order, "fringe order, left image", "period, counted from the left of the projector", cmap="turbo")


def error(m: Measurement) -> Any:
    """Length of each point's error."""
    away = 1e3 * np.linalg.norm(m.cloud.xyz - m.truth.xyz, axis=-1)
    right = away[away < 1000]
    title = f"error of the points, rms {np.sqrt((right**2).mean()):.0f} um of those below 1 mm"
    return _map(away, title, "um", cmap="magma_r", vmin=0, vmax=200)


def cloud(m: Measurement) -> Any:
    """Depth of the cloud, seen from the side."""
    z = m.cloud.xyz[..., 2]
    low, high = np.nanpercentile(z, (0.5, 99.5))
    color = plt.get_cmap("turbo")(1 - np.clip((z - low) / (high - low), 0, 1))[..., :3]
    return _three_dimensional(m, color, View(yaw_deg=-32, pitch_deg=16), "#ffffff", _INK)


def hero(m: Measurement) -> Any:
    """The textured cloud, on a dark background."""
    return _three_dimensional(m, m.color, View(yaw_deg=-30, pitch_deg=14), "#12161b", "#c9d1d9")


def _three_dimensional(m: Measurement, color: NDArray[Any], view: View, background: str, ink: str) -> Any:
    image = render(m.cloud.xyz, color, m.layout, view)
    height, width = image.pixels.shape[:2]
    figure = plt.figure(figsize=(width / 2 / _DPI, height / 2 / _DPI), facecolor=background)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.imshow(image.pixels, extent=(0, width, height, 0), interpolation="antialiased", zorder=1)
    axes.set(xlim=(0, width), ylim=(height, 0))
    axes.set_axis_off()
    for line in image.grid:
        axes.plot(*line.T, color=ink, linewidth=0.5, alpha=0.35, zorder=0.5)
    for line in image.edges:
        axes.plot(*line.T, color=ink, linewidth=1.0, alpha=0.9, zorder=0.6)
    for (x, y), text, (dx, dy) in image.labels:
        axes.annotate(
            text, (x, y), (dx, dy), textcoords="offset points", color=ink, ha="center", va="center", fontsize=8
        )
    return figure
