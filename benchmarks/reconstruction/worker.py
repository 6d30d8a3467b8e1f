"""A process that only reconstructs, so that times and memory hold no renderer and no benchmark.

It reads a pickled :class:`Job` from standard input and prints a :class:`Timing` as JSON.
"""

from __future__ import annotations

import itertools
import json
import os
import pickle
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daemon.cli.allocator import SPIN_COUNT
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_LIMIT_S = 600


@dataclass(frozen=True, slots=True)
class Job:
    """A reconstruction to be timed.

    Args:
        calibration, pattern, volume, encoding: of the rig.
        files: of :mod:`benchmarks.reconstruction.rendered`, shown in turn, forth and back.
        threads: of the process; repeats: pairs to time, after two that are not.
        stride: spacing of the measured pixels; use_prior: with the temporal prior.
        clouds: folder for the points of every file, ``0.npy`` and so on, made after the timing.
    """

    calibration: Calibration
    pattern: ColorFringe
    volume: Volume
    encoding: str
    files: tuple[Path, ...]
    threads: int
    repeats: int
    stride: int = 1
    use_prior: bool = False
    clouds: Path | None = None


@dataclass(frozen=True, slots=True)
class Timing:
    """Times and memory of a job.

    Args:
        total_ms: of each pair; stage_ms: by stage, of each pair.
        ready_s: to build the tables and load (or compile) the kernels.
        peak_mib: largest resident memory; images_mib: the share of it that the job's own images take.
    """

    total_ms: list[float]
    stage_ms: dict[str, list[float]]
    ready_s: float
    peak_mib: float
    images_mib: float


def run(job: Job) -> Timing:
    """The job in a process of its own."""
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks.reconstruction.worker"],
        input=pickle.dumps(job),
        stdout=subprocess.PIPE,
        cwd=Path(__file__).resolve().parents[2],
        env=environment(job.threads),
        timeout=_LIMIT_S,
        check=True,
    )
    return Timing(**json.loads(result.stdout))


# The daemon's own tuning (daemon.cli.allocator), set from outside for the C library; the peers get it as well.
_TUNING = {
    "OMP_WAIT_POLICY": "PASSIVE",
    "GOMP_SPINCOUNT": SPIN_COUNT,
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(1 << 30),
    "MALLOC_ARENA_MAX": "1",
}


def environment(threads: int) -> dict[str, str]:
    """Of a process whose libraries use so many threads, tuned as the daemon is."""
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return os.environ | _TUNING | dict.fromkeys(names, str(threads))


def work(job: Job) -> Timing:
    """The job in this process."""
    pairs = []
    for file in job.files:
        with np.load(file) as arrays:
            pairs.append((arrays["left"], arrays["right"]))
    start = time.perf_counter()
    reconstructor = Reconstructor(
        job.calibration, job.pattern, job.volume, encoding=job.encoding, clock=time.perf_counter_ns, threads=job.threads
    )
    reconstructor.warm_up()
    ready_s = time.perf_counter() - start
    options: dict[str, Any] = {"stride": job.stride, "use_prior": job.use_prior}
    shown = forth_and_back(len(pairs))
    for _ in range(2):
        # The first pair sets the projector's correction, and the prior of those that follow.
        reconstructor.reconstruct(*pairs[next(shown)], **options)
    total_ms: list[float] = []
    stage_ms: dict[str, list[float]] = {}
    for _ in range(job.repeats):
        left, right = pairs[next(shown)]
        start = time.perf_counter()
        cloud = reconstructor.reconstruct(left, right, **options)
        total_ms.append(1e3 * (time.perf_counter() - start))
        for name, ms in cloud.ms.items():
            stage_ms.setdefault(name, []).append(ms)
    peak = peak_memory_mib()
    images = sum(left.nbytes + right.nbytes for left, right in pairs) / 2**20
    if job.clouds is not None:
        for _ in range(max(1, 2 * len(pairs) - 2)):
            # In the same order as before, so that the prior stays that of the neighbouring image.
            i = next(shown)
            np.save(job.clouds / f"{i}.npy", reconstructor.reconstruct(*pairs[i], **options).xyz)
    return Timing(total_ms, stage_ms, ready_s, peak, images)


def peak_memory_mib() -> float:
    """Largest resident memory of this process so far.

    Not ``ru_maxrss``: that of a child process begins with its parent's.
    """
    found = re.search(r"VmHWM:\s+(\d+) kB", Path("/proc/self/status").read_text())
    if found is None:
        raise OSError("/proc/self/status has no VmHWM")
    return int(found[1]) / 1024


def forth_and_back(count: int) -> Iterator[int]:
    """0, 1 .. count - 1 .. 1, 0, 1 ..: no jump from the last image to the first."""
    return itertools.cycle([*range(count), *range(count - 2, 0, -1)])


if __name__ == "__main__":
    print(json.dumps(asdict(work(pickle.load(sys.stdin.buffer)))))
