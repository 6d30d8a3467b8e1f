"""Every stage against what this machine's memory and arithmetic allow.

``python -m benchmarks.reconstruction.roofline``: reads a pickled job, prints what its stages execute and touch, by
:mod:`benchmarks.reconstruction.counted`.
"""

from __future__ import annotations

import gc
import hashlib
import json
import pickle
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numba
import numpy as np

from benchmarks.common.tables import Table
from benchmarks.reconstruction import counted, rendered, worker
from benchmarks.reconstruction.speed import KINDS, THREADS, timed
from daemon.kernels.cache import cache_key
from pipeline.common.parallel_for import parallel
from pipeline.reconstruct.reconstructor import Reconstructor

_LIMIT_S = 900  # the first run compiles every kernel with counters
_TRIAD, BANDS = 1 << 25, 64
_REPEATS, _CACHED, PASSES = 64, 2048, 2000
_COEFFICIENTS = 16
_ROOT = Path(__file__).resolve().parents[2]


@parallel
def triad(band: int, a: Any, b: Any, c: Any) -> None:
    """One band of a = b + 0.5 c: two numbers read, one written."""
    n = a.shape[0] // BANDS
    out, x, y = a[band * n : (band + 1) * n], b[band * n : (band + 1) * n], c[band * n : (band + 1) * n]
    for j in range(n):
        out[j] = x[j] + np.float32(0.5) * y[j]


@parallel
def horner(row: int, x: Any, p: Any, out: Any) -> None:
    """Polynomials of degree 16 of a row that the innermost cache holds, many times: 32 operations per number."""
    c0, c1, c2, c3, c4, c5, c6, c7 = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    c8, c9, d0, d1, d2, d3, d4, d5, d6 = p[8], p[9], p[10], p[11], p[12], p[13], p[14], p[15], p[16]
    for _ in range(PASSES):
        for j in range(x.shape[1]):
            t = x[row, j]
            y = ((((((((c0 * t + c1) * t + c2) * t + c3) * t + c4) * t + c5) * t + c6) * t + c7) * t + c8) * t + c9
            out[row, j] = ((((((y * t + d0) * t + d1) * t + d2) * t + d3) * t + d4) * t + d5) * t + d6


def rates(threads: int) -> tuple[float, float]:
    """GB/s read and written, and Gflop/s, of loops that do nothing else; the best of several runs."""
    numba.set_num_threads(threads)
    a, b, c = (np.ones(_TRIAD, np.float32) for _ in range(3))
    x, out = np.full((_REPEATS, _CACHED), 0.5, np.float32), np.empty((_REPEATS, _CACHED), np.float32)
    p = np.linspace(0.1, 0.9, _COEFFICIENTS + 1).astype(np.float32)
    memory = _best_s(lambda: triad(BANDS, a, b, c))
    arithmetic = _best_s(lambda: horner(_REPEATS, x, p, out))
    return 3 * a.nbytes / memory / 1e9, 2 * _COEFFICIENTS * x.size * PASSES / arithmetic / 1e9


def _best_s(work: Callable[[], None]) -> float:
    times = []
    for _ in range(7):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return min(times)


def count(job: worker.Job) -> dict[str, dict[str, float]]:
    """Millions of every count by stage of one pair, in this process: the kinds of operations, bytes in two ways."""
    value = counted.count_operations()
    source: Callable[[], int] = lambda: 0  # noqa: E731 - replaced below
    with np.load(job.files[0]) as arrays:
        pair = arrays["left"], arrays["right"]
    # The stages' stopwatch reads a counter instead of a clock: its milliseconds are millions of the count.
    reconstructor = Reconstructor(
        job.calibration, job.pattern, job.volume, encoding=job.encoding, clock=lambda: source(), threads=1
    )
    for _ in range(2):
        reconstructor.reconstruct(*pair)
    gc.disable()
    found: dict[str, dict[str, float]] = {}
    for kind in counted.KINDS:
        source = partial(value, kind)
        found[kind] = reconstructor.reconstruct(*pair).ms
    for kind, by_loop in (("bytes", False), ("bytes by loop", True)):
        source = counted.TouchedMemory(by_loop=by_loop).total
        reconstructor.reconstruct(*pair)
        found[kind] = reconstructor.reconstruct(*pair).ms
    return found


def counts(job: worker.Job) -> dict[str, dict[str, float]]:
    """The same in a process of its own, whose compiled kernels are kept for the next run."""
    source = Path(counted.__file__).read_bytes()
    kept = rendered.OUT / "counted" / hashlib.sha256(cache_key().encode() + source).hexdigest()[:16]
    for other in kept.parent.glob("*"):
        if other != kept:
            shutil.rmtree(other, ignore_errors=True)
    for _ in range(1 if kept.exists() else 2):  # a process that has compiled touches more memory of its own
        result = subprocess.run(
            [sys.executable, "-m", "benchmarks.reconstruction.roofline"], input=pickle.dumps(job),
            stdout=subprocess.PIPE, cwd=_ROOT, timeout=_LIMIT_S, check=True,
            env=worker.environment(1) | counted.IN_HEAP | {"NUMBA_CACHE_DIR": str(kept)},
        )  # fmt: skip
    found: dict[str, dict[str, float]] = json.loads(result.stdout)
    return found


def against_limits(repeats: int) -> tuple[Table, dict[str, Any]]:
    """The table of a three-chip pair by itself, and its figures."""
    kind, case = next(iter(KINDS.items()))
    pair = rendered.stored_pair(case)
    job = worker.Job(
        case.layout.calibration_for(case.optics), case.pattern, case.layout.volume(), case.encoding, (pair.file,), 1, 1
    )
    found = counts(job)
    timing = timed(case, [pair], THREADS[-1], repeats)
    speeds = {threads: rates(threads) for threads in THREADS}
    gb, gflop = speeds[THREADS[-1]]
    table = Table(
        "roofline",
        f"A {kind} pair by itself against the limits of this machine, {THREADS[-1]} threads",
        ["stage", "MB", "MB by loop", "Mflop", "M other", "M instructions", "ms", "ms at memory limit",
         "ms at arithmetic limit", "limit / ms %"],
    )  # fmt: skip
    measured = {stage: statistics.median(values) for stage, values in timing.stage_ms.items()}
    least = 0.0  # of the stages one after the other
    for stage, ms in [*measured.items(), ("all", statistics.median(timing.total_ms))]:
        values = {what: by.get(stage, sum(by[name] for name in measured)) for what, by in found.items()}
        limits = values["bytes"] / gb, values["flops"] / gflop
        share = (max(limits) if stage in measured else least) / ms
        least += max(limits)
        table.add(
            stage, *(f"{values[what]:.0f}" for what in ("bytes", "bytes by loop", "flops", "others", "instructions")),
            f"{ms:.1f}", *(f"{limit:.2f}" for limit in limits), f"{100 * share:.0f}",
        )  # fmt: skip
    shown = ", ".join(f"{n} thread{'s' * (n != 1)} {g:.1f} GB/s and {f:.0f} Gflop/s" for n, (g, f) in speeds.items())
    table.notes += [f"Measured limits: {shown}.", _NOTE]
    figures = {"counts": found, "ms": measured, "limits": {n: list(pair) for n, pair in speeds.items()}}
    return table, figures


_NOTE = (
    "Counted in the compiled code as it runs. MB: pages of 4 KiB that a stage reads or writes, each once; by loop: "
    "once for each parallel loop. Mflop: additions, multiplications, divisions and roots of floats; other: integer "
    "operations, comparisons, selections and conversions; both by element of a vector. Not in the limits: pages that a "
    "stage reads several times or finds in a cache, all other instructions, gathers, branches. Limits: a = b + s c in "
    "arrays of 128 MiB; polynomials of numbers in the innermost cache, whose multiplications and additions are fused."
)


if __name__ == "__main__":
    print(json.dumps(count(pickle.load(sys.stdin.buffer))))
