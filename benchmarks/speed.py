"""Milliseconds by stage, one and two threads, each pair by itself and with the temporal prior; and memory."""

from __future__ import annotations

import os
import statistics
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks import rendered
from benchmarks.cases import CASES, Case
from benchmarks.rendered import Shot
from benchmarks.tables import Table, median_and_worst
from benchmarks.worker import FOLLOWS, Job, Timing, run
from sim.score import Score, score

ALONE_PER_S, FOLLOWING_PER_S = 30.0, 60.0
"""Promised pairs a second, two threads, three-chip pictures of 1024 x 820."""
BUDGET_MS = {
    "decode": 8.0,
    "candidates": 6.0,
    "aggregation": 4.0,
    "propagation": 2.0,
    "refinement": 8.0,
    "gates": 4.0,
    "output": 1.3,
}
"""What each stage may take of the 33.3 ms of a pair by itself."""
THREADS = tuple(n for n in (1, 2) if n <= (os.cpu_count() or 1))
FRAMES, RATE_HZ = 12, 30.0


def measure(
    case: Case, shots: Sequence[Shot], threads: int, repeats: int, *, follow: bool = False
) -> tuple[Timing, Score]:
    """Time a case in a process of its own, and score its last cloud."""
    with tempfile.TemporaryDirectory() as folder:
        cloud = Path(folder) / "cloud.npy"
        calibration = case.layout.calibration_for(case.optics)
        files = tuple(shot.file for shot in shots)
        timing = run(
            Job(
                calibration, case.pattern, case.layout.volume(), case.encoding, files, threads, repeats, follow, cloud
            )
        )
        return timing, score(np.load(cloud), shots[timing.last].truth_left)


def median(timing: Timing) -> float:
    """Milliseconds of a whole pair."""
    return statistics.median(timing.total_ms)


def by_stage(repeats: int) -> tuple[Table, Table, dict[str, Timing]]:
    """Table of stages of both kinds of sensor, table of memory, and the timings by ``kind/threads``."""
    kinds = {"three-chip": CASES[0], "Bayer": next(c for c in CASES if c.encoding != "rgb8")}
    timings = {
        f"{kind}/{threads}": measure(case, [rendered.shot(case)], threads, repeats)[0]
        for kind, case in kinds.items()
        for threads in THREADS
    }
    return stage_table("stages", "Milliseconds by stage, each pair by itself: median / worst", timings), (
        _memory(timings)
    ), timings


def live(repeats: int) -> tuple[Table | None, dict[str, Timing]]:
    """The moving scene, each pair by itself and with the temporal prior; no table where there is no such prior."""
    if not FOLLOWS:
        return None, {}
    case, shots = rendered.moving(FRAMES, RATE_HZ)
    # One turn forth and back, or more: every frame counts.
    repeats = max(repeats, 2 * FRAMES - 2)
    timings, notes = {}, []
    for word, follow in (("by itself", False), ("following", True)):
        for threads in THREADS:
            timing, found = measure(case, shots, threads, repeats, follow=follow)
            timings[f"{word}/{threads}"] = timing
        notes.append(
            f"Last pair, {word}: {100 * found.reconstructed:.2f} % within 1 mm, {100 * found.wrong:.3f} % wrong, "
            f"{1e3 * found.rms_mm:.0f} um rms."
        )
    title = f"Moving scene at {RATE_HZ:.0f} pictures a second ({FRAMES} pairs forth and back): median / worst ms"
    table = stage_table("live", title, timings)
    table.notes += notes
    return table, timings


def stage_table(name: str, title: str, timings: dict[str, Timing]) -> Table:
    """One column of ``median / worst`` for each timing, one row for each stage, and the rates below."""
    stages = list(dict.fromkeys(stage for timing in timings.values() for stage in timing.stage_ms))
    headings = [f"{kind}, {count} thread{'s' * (count != '1')}" for kind, count in (k.split("/") for k in timings)]
    table = Table(name, title, ["stage", *headings, "budget"])
    for stage in stages:
        cells = [" / ".join(median_and_worst(t.stage_ms[stage])) if stage in t.stage_ms else "" for t in timings.values()]
        table.add(stage, *cells, f"{BUDGET_MS[stage]:.1f}" if stage in BUDGET_MS else "")
    table.add("all", *(" / ".join(median_and_worst(t.total_ms)) for t in timings.values()), f"{1e3 / ALONE_PER_S:.1f}")
    table.add("pairs a second", *(f"{1e3 / median(t):.1f}" for t in timings.values()), f"{ALONE_PER_S:.0f}")
    table.notes.append(
        "Median / worst of the stages need not add up to those of the whole. The budget is for a three-chip pair by "
        "itself on two threads."
    )
    return table


def _memory(timings: dict[str, Timing]) -> Table:
    table = Table("memory", "A process that only reconstructs", ["pictures", "peak memory MiB", "of it pictures MiB", "ready after s"])
    for name, timing in timings.items():
        kind, threads = name.split("/")
        table.add(
            f"{kind}, {threads} thread{'s' * (threads != '1')}", f"{timing.peak_mib:.0f}",
            f"{timing.pictures_mib:.0f}", f"{timing.ready_s:.1f}",
        )  # fmt: skip
    table.notes.append(
        "Resident memory with Python, numba and OpenCV, one pair at a time. Ready: tables built, kernels loaded from the "
        "cache (or compiled, if this was their first run) and run once."
    )
    return table


def promises(alone: Timing, following: Timing | None) -> list[tuple[str, bool]]:
    """The promised rates, each with whether it is kept."""
    found = [(f"{1e3 / median(alone):.1f} pairs a second by themselves, promised {ALONE_PER_S:.0f}",
              median(alone) <= 1e3 / ALONE_PER_S)]  # fmt: skip
    if following is not None:
        rate = 1e3 / median(following)
        found.append((f"{rate:.1f} pairs a second with the temporal prior, promised {FOLLOWING_PER_S:.0f}",
                      rate >= FOLLOWING_PER_S))  # fmt: skip
    return found
