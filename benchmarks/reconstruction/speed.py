"""Milliseconds by stage, one and two threads, each pair by itself, at half resolution and with the temporal prior."""

from __future__ import annotations

import os
import statistics
import tempfile
from collections.abc import Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.tables import Table, median_and_worst
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import CASES, Case
from benchmarks.reconstruction.rendered import StoredPair
from benchmarks.reconstruction.worker import Job, Timing, run
from sim.evaluate.score import Score, score
from sim.render.ground_truth import Truth

ALONE_PER_S = 30.0
"""Promised pairs a second by themselves, two threads, three-chip images of 1024 x 820."""
BUDGET_MS = {"decode": 10.0, "orders": 12.0, "propagation": 2.0, "refinement": 10.0}
"""Limit of each stage for such a pair of 33.3 ms; together they are a little more than the whole."""
THREADS = tuple(n for n in (1, 2) if n <= (os.cpu_count() or 1))
FRAMES, RATE_HZ = 12, 30.0
KINDS = {"three-chip": CASES[0], "Bayer": next(case for case in CASES if case.encoding != "rgb8")}
WAYS: dict[str, dict[str, Any]] = {
    "by itself": {},
    "following": {"use_prior": True},
    "half": {"stride": 2},
    "half, following": {"stride": 2, "use_prior": True},
}
"""How a pair of the moving scene is measured, as options of the reconstruction."""


def timed(
    case: Case, pairs: Sequence[StoredPair], threads: int, repeats: int, *, clouds: Path | None = None, **options: Any
) -> Timing:
    """Time a case in a process of its own; ``clouds`` is a folder for the points of every pair."""
    calibration, volume = case.layout.calibration_for(case.optics), case.layout.volume()
    files = tuple(pair.file for pair in pairs)
    return run(Job(calibration, case.pattern, volume, case.encoding, files, threads, repeats, clouds=clouds, **options))


def measure(
    case: Case, pairs: Sequence[StoredPair], threads: int, repeats: int, **options: Any
) -> tuple[Timing, Score]:
    """Time a case and score its clouds: the mean of all pairs."""
    with tempfile.TemporaryDirectory() as folder:
        timing = timed(case, pairs, threads, repeats, clouds=Path(folder), **options)
        stride = options.get("stride", 1)
        scores = [scored(np.load(f"{folder}/{i}.npy"), pair.truth_left, stride) for i, pair in enumerate(pairs)]
    return timing, mean_score(scores)


def scored(xyz: NDArray[np.float32], truth: Truth, stride: int) -> Score:
    """Score a cloud that holds only every n-th pixel of both axes, by these pixels."""
    if stride > 1 and xyz.shape == truth.xyz.shape:
        xyz = xyz[::stride, ::stride]
    return score(xyz, Truth(**{item.name: getattr(truth, item.name)[::stride, ::stride] for item in fields(Truth)}))


def mean_score(scores: Sequence[Score]) -> Score:
    """Mean of every figure."""
    mean: dict[str, Any] = {n.name: float(np.mean([getattr(one, n.name) for one in scores])) for n in fields(Score)}
    return Score(**{**mean, "points": round(mean["points"])})


def median(timing: Timing) -> float:
    """Milliseconds of a whole pair."""
    return statistics.median(timing.total_ms)


def by_stage(repeats: int) -> tuple[Table, Table, dict[str, Timing]]:
    """Table of stages of both kinds of sensor, table of memory, and the timings by ``kind/threads``."""
    timings: dict[str, Timing] = {}
    notes = []
    for kind, case in KINDS.items():
        # Whatever must be compiled is compiled here: the memory table is about measuring.
        pairs = [rendered.stored_pair(case)]
        timed(case, pairs, THREADS[-1], 1)
        for threads in THREADS:
            timings[f"{kind}/{threads}"], found = measure(case, pairs, threads, repeats)
        notes.append(f"{kind}: {quality(found)}.")
    title = f"Milliseconds by stage of a pair by itself, median / worst of {repeats}"
    table = stage_table("stages", title, timings)
    table.notes += [
        "Stages are timed one by one: their medians need not add up to that of the whole. The budget is for a "
        "three-chip pair on two threads.",
        *notes,
    ]
    return table, memory_table(timings), timings


def live(repeats: int, frames: int) -> tuple[Table, Table, dict[str, Timing]]:
    """The moving scene in every way: table of stages, table of time beside accuracy, timings by ``way/threads``."""
    case, pairs = rendered.moving(frames, RATE_HZ)
    # One turn forth and back, or more: every frame counts.
    repeats = max(repeats, 2 * frames - 2)
    timings: dict[str, Timing] = {}
    accuracy = Table(
        "live accuracy",
        "What the temporal prior and half resolution cost or bring",
        ["way", "ms", "pairs a second", "within 1 mm %", "wrong %", "rms um", "points"],
    )
    for way, options in WAYS.items():
        timed(case, pairs[:1], THREADS[-1], 1, **options)
        if "stride" not in options and len(THREADS) > 1:
            timings[f"{way}/1"] = timed(case, pairs, 1, repeats, **options)
        timings[f"{way}/{THREADS[-1]}"], found = measure(case, pairs, THREADS[-1], repeats, **options)
        ms = median(timings[f"{way}/{THREADS[-1]}"])
        accuracy.add(way, f"{ms:.1f}", f"{1e3 / ms:.1f}", *cells(found), f"{found.points}")
    accuracy.notes.append(
        f"{THREADS[-1]} threads; accuracy is the mean of {frames} pairs. At half resolution the shares are of the "
        "pixels that are measured, every second of both axes."
    )
    title = f"Moving scene at {RATE_HZ:.0f} images a second, {frames} pairs forth and back: median / worst ms"
    return stage_table("live", title, timings), accuracy, timings


def cells(found: Score) -> tuple[str, str, str]:
    """Coverage, wrong share and error, as text."""
    return f"{100 * found.reconstructed:.2f}", f"{100 * found.wrong:.3f}", f"{1e3 * found.rms_mm:.0f}"


def quality(found: Score) -> str:
    """The same as part of a sentence."""
    right, wrong, rms = cells(found)
    return f"{right} % within 1 mm, {wrong} % wrong, {rms} um rms"


def stage_table(name: str, title: str, timings: dict[str, Timing]) -> Table:
    """One column of ``median / worst`` for each timing, one row for each stage, and the rates below."""
    stages = list(dict.fromkeys(stage for timing in timings.values() for stage in timing.stage_ms))
    headings = [f"{kind}, {count} thread{'s' * (count != '1')}" for kind, count in (k.split("/") for k in timings)]
    table = Table(name, title, ["stage", *headings, "budget"])
    for stage in stages:
        table.add(stage, *(_spread(t.stage_ms.get(stage, ())) for t in timings.values()), _budget(stage))
    table.add("all", *(_spread(t.total_ms) for t in timings.values()), f"{1e3 / ALONE_PER_S:.1f}")
    table.add("pairs a second", *(f"{1e3 / median(t):.1f}" for t in timings.values()), f"{ALONE_PER_S:.0f}")
    return table


def _spread(values: Sequence[float]) -> str:
    return " / ".join(median_and_worst(values)) if values else ""


def _budget(stage: str) -> str:
    return f"{BUDGET_MS[stage]:.0f}" if stage in BUDGET_MS else ""


def memory_table(timings: dict[str, Timing]) -> Table:
    """Peak memory and time until ready of each timing."""
    headings = ["images", "peak memory MiB", "of it images MiB", "ready after s"]
    table = Table("memory", "A process that only reconstructs", headings)
    for name, timing in timings.items():
        kind, threads = name.split("/")
        what = f"{kind}, {threads} thread{'s' * (threads != '1')}"
        table.add(what, f"{timing.peak_mib:.0f}", f"{timing.images_mib:.0f}", f"{timing.ready_s:.1f}")
    table.notes.append(
        "Largest resident memory with Python, numba and OpenCV, one pair at a time, kernels compiled before and loaded "
        "from numba's cache. Ready: tables built, kernels loaded and run once; the very first start compiles as well."
    )
    return table


def promises(alone: Timing) -> list[tuple[str, bool]]:
    """The promised rate, with whether it is kept."""
    rate = 1e3 / median(alone)
    what = f"{rate:.1f} pairs a second by themselves, promised {ALONE_PER_S:.0f}"
    return [(what, rate >= ALONE_PER_S)]
