"""A process that only reconstructs: times and memory are its own, no renderer and no benchmark beside it.

``python -m benchmarks.worker`` reads a pickled :class:`Job` from standard input and prints a :class:`Timing` as JSON.
"""

from __future__ import annotations

import inspect
import itertools
import json
import os
import pickle
import resource
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.calibration import Calibration
from pipeline.cloud import Volume
from pipeline.pattern import ColorFringe
from pipeline.reconstruct import Reconstructor

FOLLOWS = "follow" in inspect.signature(Reconstructor.reconstruct).parameters
_LIMIT_S = 600


@dataclass(frozen=True, slots=True)
class Job:
    """What to reconstruct, and how often.

    Args:
        calibration, pattern, volume, encoding: of the rig.
        files: of :mod:`benchmarks.rendered`, shown in turn, forth and back.
        threads: of the process; repeats: pairs to time, after two that are not.
        follow: with the temporal prior; cloud: file for the points of the last pair.
    """

    calibration: Calibration
    pattern: ColorFringe
    volume: Volume
    encoding: str
    files: tuple[Path, ...]
    threads: int
    repeats: int
    follow: bool = False
    cloud: Path | None = None


@dataclass(frozen=True, slots=True)
class Timing:
    """What a job took.

    Args:
        total_ms: of each pair; stage_ms: by stage, of each pair.
        ready_s: to build the tables and load (or compile) the kernels.
        peak_mib: largest resident memory; pictures_mib: the share of it that the job's own pictures take.
        last: which of the files was shown last; points: of its cloud.
    """

    total_ms: list[float]
    stage_ms: dict[str, list[float]]
    ready_s: float
    peak_mib: float
    pictures_mib: float
    last: int
    points: int


def run(job: Job) -> Timing:
    """The job in a process of its own."""
    count = str(job.threads)
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    result = subprocess.run(
        [sys.executable, "-m", "benchmarks.worker"],
        input=pickle.dumps(job),
        stdout=subprocess.PIPE,
        env=os.environ | dict.fromkeys(names, count),
        timeout=_LIMIT_S,
        check=True,
    )
    return Timing(**json.loads(result.stdout))


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
    options: dict[str, Any] = {"follow": True} if job.follow else {}
    shown = _there_and_back(len(pairs))
    last = next(shown)
    for _ in range(2):
        # The first pair sets the projector's correction, and the prior of those that follow.
        cloud = reconstructor.reconstruct(*pairs[last], **options)
    total_ms: list[float] = []
    stage_ms: dict[str, list[float]] = {}
    for _ in range(job.repeats):
        last = next(shown)
        start = time.perf_counter()
        cloud = reconstructor.reconstruct(*pairs[last], **options)
        total_ms.append(1e3 * (time.perf_counter() - start))
        for name, ms in cloud.ms.items():
            stage_ms.setdefault(name, []).append(ms)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    pictures = sum(left.nbytes + right.nbytes for left, right in pairs) / 2**20
    if job.cloud is not None:
        np.save(job.cloud, cloud.xyz)
    return Timing(total_ms, stage_ms, ready_s, peak, pictures, last, cloud.points)


def _there_and_back(count: int) -> Iterator[int]:
    """0, 1 .. count - 1 .. 1, 0, 1 ..: no jump from the last picture to the first."""
    return itertools.cycle([*range(count), *range(count - 2, 0, -1)])


if __name__ == "__main__":
    print(json.dumps(asdict(work(pickle.load(sys.stdin.buffer)))))
