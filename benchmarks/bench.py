"""Accuracy of every case and speed by stage, as tables: ``make bench``.

Medians; other programs on the machine show in the spread. Rows that carry a promise say whether it is kept, and the
exit code is 1 if one is not.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import time
from collections.abc import Sequence

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.cases import CASES, Case, measure


def accuracy(cases: Sequence[Case], console: Console, seeds: int) -> bool:
    """Print the accuracy table; True when every promise is kept."""
    table = Table(title="Accuracy (truth of the simulator; default settings)")
    for heading in ("case", "within 1 mm %", "wrong %", "rms um", "5x5 rms um", "bias um", "points", "promise"):
        table.add_column(heading, justify="left" if heading in ("case", "promise") else "right")
    kept = True
    for case in cases:
        scores = []
        for seed in range(seeds):
            reconstructor = case.reconstructor()
            scores.append(measure(case.render(seed), reconstructor)[1])
        mean = {name: float(np.mean([getattr(s, name) for s in scores])) for name in type(scores[0]).__slots__}
        word = ""
        if case.promise is not None:
            good = (
                mean["reconstructed"] >= case.promise[0]
                and mean["wrong"] <= case.promise[1]
                and mean["rms_mm"] <= case.promise[2]
            )
            kept &= good
            limits = f"{100 * case.promise[0]:.1f} / {100 * case.promise[1]:.2f} / {1e3 * case.promise[2]:.0f}"
            word = ("kept " if good else "MISSED ") + limits
        table.add_row(
            case.name, f"{100 * mean['reconstructed']:.2f}",
            f"{100 * mean['wrong']:.3f}", f"{1e3 * mean['rms_mm']:.0f}",
            f"{1e3 * mean['smooth_rms_mm']:.0f}", f"{1e3 * mean['bias_mm']:+.1f}", f"{mean['points']:.0f}", word,
        )  # fmt: skip
    console.print(table)
    return kept


def speed(case: Case, console: Console, repeats: int) -> bool:
    """Print milliseconds by stage of one pair; True when at least four pairs a second are reached."""
    pair = case.render()
    reconstructor = case.reconstructor(clock=time.perf_counter_ns)
    reconstructor.warm_up()
    reconstructor.reconstruct(pair.left, pair.right)
    stages: dict[str, list[float]] = {}
    totals = []
    for _ in range(repeats):
        start = time.perf_counter()
        cloud = reconstructor.reconstruct(pair.left, pair.right)
        totals.append(1e3 * (time.perf_counter() - start))
        for name, ms in cloud.ms.items():
            stages.setdefault(name, []).append(ms)
    table = Table(title=f"Speed: {case.name}, {pair.left.shape[1]} x {pair.left.shape[0]}, {repeats} pairs")
    for heading in ("stage", "median ms", "worst ms"):
        table.add_column(heading, justify="left" if heading == "stage" else "right")
    for name, values in stages.items():
        table.add_row(name, f"{statistics.median(values):.1f}", f"{max(values):.1f}")
    table.add_row("all", f"{statistics.median(totals):.1f}", f"{max(totals):.1f}", style="bold")
    console.print(table)
    rate = 1e3 / statistics.median(totals)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    console.print(f"{rate:.2f} pairs a second (promise: 4); peak memory {peak:.0f} MiB, renderer included")
    return rate >= 4


def main() -> int:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=1, help="noise and texture seeds to average over")
    parser.add_argument("--repeats", type=int, default=15, help="pairs to time")
    parser.add_argument("--only", help="run the cases whose name contains this")
    options = parser.parse_args()
    console = Console(width=None if sys.stdout.isatty() else 140)
    cases = [c for c in CASES if not options.only or options.only in c.name]
    kept = accuracy(cases, console, options.seeds)
    fast = speed(CASES[0], console, options.repeats)
    mosaic = next(c for c in CASES if c.encoding != "rgb8")
    speed(mosaic, console, options.repeats)
    return 0 if kept and fast else 1


if __name__ == "__main__":
    sys.exit(main())
