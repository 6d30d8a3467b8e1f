"""Figures of a benchmark's results; runs in the peers' environment, which has matplotlib.

``python plots.py RESULTS.json FOLDER``: one figure for each section that was measured; imports nothing of this project.
"""

from __future__ import annotations

import json
import statistics
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("svg")
import matplotlib.pyplot as plt

# The same results give the same file.
mpl.rcParams["svg.hashsalt"] = "fringed"
mpl.rcParams.update({"axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.alpha": 0.3})
_REAL_TIME_MS = 1e3 / 30
_COLORS = ("#1b6ca8", "#d1495b", "#edae49", "#66a182", "#8d6a9f", "#4f5d75", "#a3a3a3")


def stages(figures: dict[str, Any], folder: Path) -> None:
    """Milliseconds of a pair by stage."""
    figure, axes = plt.subplots(figsize=(7.5, 0.9 + 0.5 * len(figures)), layout="constrained")
    names = list(dict.fromkeys(stage for timing in figures.values() for stage in timing["stage_ms"]))
    labels = [f"{kind}, {n} thread{'s' * (n != '1')}" for kind, n in (key.split("/") for key in figures)]
    left = [0.0] * len(figures)
    for name, color in zip(names, _COLORS * 2, strict=False):
        widths = [statistics.median(t["stage_ms"].get(name, [0.0])) for t in figures.values()]
        axes.barh(labels, widths, left=left, label=name, color=color, height=0.6)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    axes.axvline(_REAL_TIME_MS, color="black", linewidth=1, linestyle="--")
    axes.annotate(" 30 pairs/s", (_REAL_TIME_MS, 1), xycoords=("data", "axes fraction"), va="bottom", fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("median time per pair of images (ms)")
    figure.legend(loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    _save(figure, folder / "bench-stages.svg")


def peers(figures: dict[str, Any], folder: Path) -> None:
    """Ours beside others, logarithmic."""
    figure, axes = plt.subplots(figsize=(7.5, 0.8 + 0.4 * len(figures)), layout="constrained")
    names, values = list(figures), [row["ms"] for row in figures.values()]
    # Points: on a logarithmic axis the length of a bar has no meaning.
    axes.scatter(values, names, color=[_COLORS[1 if name == "fringed" else 0] for name in names], zorder=3)
    for name, value in zip(names, values, strict=True):
        axes.annotate(f"  {value:,.0f}", (value, name), va="center", fontsize=8)
    axes.set_xscale("log")
    axes.set_xlim(min(values) / 2, max(values) * 3)
    axes.invert_yaxis()
    axes.set_xlabel("median time per pair of images (ms, logarithmic)")
    _save(figure, folder / "bench-peers.svg")


def series(name: str, data: dict[str, Any], folder: Path) -> None:
    """Milliseconds against one thing that grows, a line per number of threads."""
    figure, axes = plt.subplots(figsize=(5.6, 3.6), layout="constrained")
    values = [point["value"] for point in data["points"]]
    for (threads, _), color in zip(data["points"][0]["ms"].items(), _COLORS, strict=False):
        label = f"{threads} thread{'s' * (threads != '1')}"
        axes.plot(values, [point["ms"][threads] for point in data["points"]], "o-", color=color, label=label)
    axes.axhline(_REAL_TIME_MS, color="black", linewidth=1, linestyle="--")
    axes.annotate(
        "30 pairs/s", (1, _REAL_TIME_MS), xycoords=("axes fraction", "data"), ha="right", va="bottom", fontsize=8
    )
    axes.set_xlim(left=0)
    axes.set_ylim(bottom=0)
    axes.set_xlabel(data["heading"])
    axes.set_ylabel("median time per pair (ms)")
    axes.legend(frameon=False)
    _save(figure, folder / f"bench-{name}.svg")


def _save(figure: Any, file: Path) -> None:
    figure.savefig(file, metadata={"Date": None})
    plt.close(figure)


def main() -> None:
    """Draw what was measured."""
    results, folder = Path(sys.argv[1]), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    figures = json.loads(results.read_text())["figures"]
    for name, draw in (("stages", stages), ("peers", peers)):
        if name in figures:
            draw(figures[name], folder)
    for name, data in figures.get("scale", {}).items():
        series(name, data, folder)


if __name__ == "__main__":
    main()
