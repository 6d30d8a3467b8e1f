"""Time of a pair with more pixels, more fringes or a deeper volume; one thread and two."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import Case
from benchmarks.reconstruction.speed import THREADS, cells, measure, median, timed
from sim.rig.layout import RigLayout

STANDARD = RigLayout()
SIZES = ((512, 410), (768, 615), (1024, 820), (1536, 1230), (2048, 1640), (2448, 2048))
"""Camera images; the last are those of 5-megapixel sensors."""
PERIODS = (48.0, 64.0, 80.0, 96.0, 112.0, 128.0)
DEPTHS_MM = (230.0, 345.0, 460.0, 690.0, 920.0)


@dataclass(frozen=True, slots=True)
class Series:
    """Cases that differ in one thing.

    Args:
        name: of the series; heading: what differs, with its unit; points: (text, value for a plot, case).
    """

    name: str
    heading: str
    points: tuple[tuple[str, float, Case], ...]


def every_series(*, quick: bool) -> Iterator[Series]:
    """All series; a quick one is the standard case and one other."""
    sizes, periods, depths = (SIZES[:3:2], PERIODS[1:4:2], DEPTHS_MM[:3:2]) if quick else (SIZES, PERIODS, DEPTHS_MM)
    yield Series(
        "pixels",
        "megapixels per image",
        tuple((f"{w} x {h}", w * h / 1e6, Case("size", "mixed", layout=with_pixels(w, h))) for w, h in sizes),
    )
    yield Series("periods", "fringe periods", tuple((f"{n:.0f}", n, Case("N", "mixed", periods=n)) for n in periods))
    yield Series(
        "depth",
        "depth of the volume, mm",
        tuple((f"{d:.0f}", d, Case("depth", "mixed", layout=replace(STANDARD, depth_mm=d))) for d in depths),
    )


def with_pixels(width: int, height: int) -> RigLayout:
    """The standard rig, field and projector, seen by cameras with more or fewer pixels."""
    focal = STANDARD.focal_px * width / STANDARD.camera_size[0]
    return replace(STANDARD, camera_size=(width, height), focal_px=focal)


def by_series(repeats: int, *, quick: bool) -> tuple[Table, dict[str, Any]]:
    """One table of all series, and the plain figures of each."""
    headings = [
        "what differs", "value", *(f"ms, {n} thread{'s' * (n != 1)}" for n in THREADS), "ns a pixel", "speed-up",
        "peak memory MiB", "within 1 mm %", "wrong %", "rms um",
    ]  # fmt: skip
    table = Table("scale", f"Scale: median of {repeats}", headings)
    figures: dict[str, Any] = {}
    done: dict[tuple[Any, ...], dict[str, Any]] = {}
    for series in every_series(quick=quick):
        figures[series.name] = {"heading": series.heading, "points": []}
        for text, value, case in series.points:
            # The standard case stands in every series; it is measured once.
            key = (case.layout, case.periods)
            found = done.get(key) or _point(case, repeats)
            done[key] = found
            ms = [f"{found['ms'][str(n)]:.1f}" for n in THREADS]
            speed_up = found["ms"][str(THREADS[0])] / found["ms"][str(THREADS[-1])]
            table.add(
                series.heading, text, *ms, f"{found['ns_per_pixel']:.1f}", f"{speed_up:.2f}",
                f"{found['peak_mib']:.0f}", *found["cells"],
            )  # fmt: skip
            figures[series.name]["points"].append({"value": value, **found})
    table.notes.append(
        f"Three-chip, the standard case but for what differs. ns a pixel (of one image), memory: {THREADS[-1]} "
        f"threads. Speed-up: {THREADS[-1]} threads against {THREADS[0]}."
    )
    return table, figures


def _point(case: Case, repeats: int) -> dict[str, Any]:
    pairs = [rendered.stored_pair(case)]
    timings = {n: timed(case, pairs, n, repeats) for n in THREADS[:-1]}
    timings[THREADS[-1]], found = measure(case, pairs, THREADS[-1], repeats)
    width, height = case.layout.camera_size
    best = median(timings[THREADS[-1]])
    return {
        "ms": {str(n): median(t) for n, t in timings.items()},
        "ns_per_pixel": 1e6 * best / (width * height),
        "peak_mib": timings[THREADS[-1]].peak_mib,
        "cells": cells(found),
    }
