"""Settings of the C libraries below, made before they begin, for a program that measures without end.

* OpenMP, which runs numba's threads, lets idle threads spin for milliseconds; on a PC with few cores that is the time
  of recorder and stream. Asleep at once they are woken forty times a pair, which takes a sixth of a pair's time where
  that is slow (in a virtual machine). Awake for some hundredths of a millisecond more, most of them need no waking, and
  beside other work they cost a tenth more processor time.
* So does OpenBLAS with its threads, for matrices here that one of them multiplies in microseconds: beside other work on
  the same processors a calibration then takes twenty times as long.
* The allocator gives every large array back to the kernel, which clears each page again when the next one is made:
  nearly four thousand page faults a pair. Kept, the same pages serve the next pair.
"""

from __future__ import annotations

import ctypes
import os

# Numbers of mallopt(3) in glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
_LARGEST_MMAP_THRESHOLD = 32 << 20  # glibc's limit; all arrays of a pair are smaller
_KEPT = 1 << 30

SPIN_COUNT = "10000"
"""Turns of the loop in which a thread without work waits before it sleeps; what libgomp, numba's OpenMP here, reads."""


def prepare() -> None:
    """Set everything; what the user's environment says comes first. Call it before numpy and numba are loaded."""
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
        os.environ.setdefault("GOMP_SPINCOUNT", SPIN_COUNT)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if not any(name.startswith("MALLOC_") for name in os.environ):
        _keep_memory()


def _keep_memory() -> None:
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return  # another C library: it has its own ways
    mallopt(_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD)
    mallopt(_TRIM_THRESHOLD, _KEPT)
    # One heap for all threads: what the stream lets go of serves the pipeline, and none is kept twice.
    mallopt(_ARENA_MAX, 1)
