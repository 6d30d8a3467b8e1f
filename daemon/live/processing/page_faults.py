"""Page faults while pairs are measured: memory that is new, or was given back, costs microseconds a page.

Linux maps a page when it is first touched. In steady state every array of a pair lies in memory that an earlier pair
used, so that the counts stay at a few; numba's threads fault as well, hence the process is counted beside the thread.
"""

from __future__ import annotations

import resource
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol

from daemon.common.counters import Percentiles


class Usage(Protocol):
    """The part of ``struct rusage`` that is read."""

    @property
    def ru_minflt(self) -> int:
        """Faults served without a disk."""

    @property
    def ru_majflt(self) -> int:
        """Faults that read a disk."""


class PageFaults:
    """Faults since the start and their distribution over pairs; call it in the pipeline's thread.

    Args:
        usage: of this process (RUSAGE_SELF) or of the calling thread (RUSAGE_THREAD).
    """

    def __init__(self, usage: Callable[[int], Usage] = resource.getrusage) -> None:
        self._usage = usage
        self._start: Usage | None = None
        self._process, self._thread = Percentiles(), Percentiles()
        self._worst, self._blocks = 0, 0

    def start(self) -> None:
        """Begin to count."""
        self._start, self._blocks = self._usage(resource.RUSAGE_SELF), sys.getallocatedblocks()

    @contextmanager
    def pair(self) -> Iterator[None]:
        """Count the faults of the block as those of one pair."""
        process, thread = self._total(resource.RUSAGE_SELF), self._total(resource.RUSAGE_THREAD)
        yield
        faults = self._total(resource.RUSAGE_SELF) - process
        self._process.note(faults)
        self._thread.note(self._total(resource.RUSAGE_THREAD) - thread)
        self._worst = max(self._worst, faults)

    def summary(self) -> dict[str, float]:
        """Faults of the process since the start, and those while a pair was measured; empty before the start.

        ``pair_...``: of all threads of the process, ``thread_...``: of the pipeline's thread alone, both over the last
        ten minutes or so; ``pair_worst``: since the start. ``python_blocks``: blocks of memory that Python's objects
        occupy beyond those at the start.
        """
        if self._start is None:
            return {}
        now = self._usage(resource.RUSAGE_SELF)
        found: dict[str, float] = {
            "minor_faults": now.ru_minflt - self._start.ru_minflt,
            "major_faults": now.ru_majflt - self._start.ru_majflt,
        }
        for name, values in (("pair", self._process.summary()), ("thread", self._thread.summary())):
            found |= {f"{name}_{share}": round(values[share]) for share in ("last", "p50", "p99") if values}
        return found | {"pair_worst": self._worst, "python_blocks": sys.getallocatedblocks() - self._blocks}

    def _total(self, who: int) -> int:
        usage = self._usage(who)
        return usage.ru_minflt + usage.ru_majflt
