"""Settings of the C libraries for continuous measuring, applied before the libraries are loaded.

* OpenMP, which runs numba's threads, lets idle threads spin for milliseconds; on a PC with few cores recorder and
  stream need that time. Threads that sleep at once are woken forty times per pair, which takes a sixth of a pair's time
  where waking is slow (in a virtual machine). A spin of some hundredths of a millisecond avoids most of the waking and
  costs a tenth more processor time beside other work.
* OpenBLAS threads spin too, for matrices that one thread multiplies in microseconds: beside other work on the same
  processors a calibration then takes twenty times as long.
* The allocator returns every large array to the kernel, which clears each page again for the next one: nearly four
  thousand page faults per pair. Kept pages are reused by the next pair.
"""

from __future__ import annotations

import ctypes
import os

# Numbers of mallopt(3) in glibc's malloc.h.
_TRIM_THRESHOLD, _MMAP_THRESHOLD, _ARENA_MAX = -1, -3, -8
_LARGEST_MMAP_THRESHOLD = 32 << 20  # glibc's limit; all arrays of a pair are smaller
_KEPT = 1 << 30

SPIN_COUNT = "10000"
"""Iterations for which an idle thread spins before it sleeps, read by libgomp, numba's OpenMP."""


def prepare() -> None:
    """Apply all settings that the user's environment does not set. Call it before the import of numpy and numba."""
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
        return  # another C library without mallopt
    mallopt(_MMAP_THRESHOLD, _LARGEST_MMAP_THRESHOLD)
    mallopt(_TRIM_THRESHOLD, _KEPT)
    # One heap for all threads: the pipeline reuses the memory that the stream has released.
    mallopt(_ARENA_MAX, 1)


def worker_environment(threads: int) -> dict[str, str]:
    """Variables of a process that computes for others, which must be set before it starts.

    Args:
        threads: of numba; one for each processor that the process may use.
    """
    return {
        "NUMBA_NUM_THREADS": str(threads),
        "OMP_NUM_THREADS": str(threads),
        "OPENBLAS_NUM_THREADS": "1",
        "OMP_WAIT_POLICY": "PASSIVE",
        "GOMP_SPINCOUNT": SPIN_COUNT,
        "MALLOC_MMAP_THRESHOLD_": str(_LARGEST_MMAP_THRESHOLD),
        "MALLOC_TRIM_THRESHOLD_": str(_KEPT),
        "MALLOC_ARENA_MAX": "1",
    }
