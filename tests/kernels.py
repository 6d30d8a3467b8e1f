"""Compiles all kernels into the cache on disk, so that the tests' time-outs are those of running them.

``python -m tests.kernels`` needs the environment of the rig only: `make test` runs it while it installs the rest.
"""

from __future__ import annotations

import sys

from daemon.common.errors import DaemonError
from daemon.kernels.jobs import ENCODINGS, later_jobs, measuring_jobs, rendering_jobs
from daemon.kernels.processes import compile_kernels

MODES = ("heterodyne", "bayer_rggb8"), ("gray", "rgb8"), ("two_color", "rgb8")
"""As far as tests use them."""


def compile_all() -> str:
    """Compile what is missing; returns what went wrong, or nothing."""
    jobs = [*rendering_jobs(ENCODINGS), *(job for encoding in ENCODINGS for job in measuring_jobs(encoding))]
    jobs += [job for mode, encoding in MODES for job in measuring_jobs(encoding, mode)]
    jobs += later_jobs()
    try:
        compile_kernels(jobs)
    except DaemonError as error:
        return str(error)
    return ""


if __name__ == "__main__":
    sys.exit(compile_all() or None)
