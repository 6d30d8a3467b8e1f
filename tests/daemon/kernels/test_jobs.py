"""After the jobs of the compilation a reconstruction finds every kernel in the cache."""

from __future__ import annotations

import subprocess
import sys

import pytest

from daemon.kernels.jobs import LATER, later_jobs, measuring_jobs, release_jobs, rendering_jobs, run_job

_PROGRAM = """
import sys
from numba.core.registry import CPUDispatcher
from pipeline.common.parallel_for import ParallelFor
from tests.pipeline.small import images, pair, reconstructor

encoding = sys.argv[1]
made = reconstructor(encoding=encoding)
made.warm_up(strides=(1, 2), use_prior=True)
made.reconstruct(*images(pair("moving", 0, encoding)))
names = [(name, v) for name, module in list(sys.modules.items()) if name.startswith("pipeline.")
         for v in vars(module).values()]
kernels = {id(v): (name, v) for name, v in names if isinstance(v, CPUDispatcher)}
kernels |= {id(v): (name, v.dispatcher) for name, v in names if isinstance(v, ParallelFor)}
missed = sorted({f"{name}.{k.py_func.__name__}" for name, k in kernels.values() if k.stats.cache_misses})
hits = sum(len(k.stats.cache_hits) for _, k in kernels.values())
print(hits > 20, *missed)
"""


@pytest.mark.parametrize("encoding", [pytest.param("rgb8", marks=pytest.mark.long), "bayer_grbg8"])
def test_a_reconstruction_finds_all_kernels_compiled(encoding: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, encoding], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == "True\n"


def test_each_job_has_its_name() -> None:
    jobs = (*measuring_jobs("bayer_rggb8", "gray"), *rendering_jobs(["rgb8"]))
    assert len(set(jobs)) == len(jobs)
    assert "mode/bayer_rggb8/gray" in jobs
    assert measuring_jobs("rgb8", "single") == measuring_jobs("rgb8")


def test_mosaics_share_their_jobs() -> None:
    assert measuring_jobs("bayer_rggb8") == measuring_jobs("bayer_grbg8")


def test_encodings_share_all_but_the_decoder() -> None:
    own = set(measuring_jobs("rgb8")) ^ set(measuring_jobs("bayer_rggb8"))
    assert {job.split("/")[2] for job in own} == {"decode rgb8", "decode mosaic"}


def test_what_no_start_needs_is_in_a_release_and_in_no_measurement() -> None:
    assert set(later_jobs()) <= set(release_jobs())
    assert not any(job.startswith(LATER) for job in measuring_jobs("rgb8", "gray"))


def test_an_unknown_job_is_an_error() -> None:
    with pytest.raises(ValueError, match="is unknown, expected measure"):
        run_job("cook/rgb8/soup")
