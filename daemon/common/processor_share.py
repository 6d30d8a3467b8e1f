"""The share of the processor time that this process wanted and got, and the time that other programs took from it.

Linux counts for every thread how long it ran and how long it was ready to run but waited for a processor
(``schedstat``). Both are added over the threads of the process and of its children. A wait behind threads of the same
process is not counted as taken: the waits are weighted by the processor time of other programs.
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

SCARCE = 0.5
"""Below this share over the last seconds the process is short of processor time."""

_WARNING = (
    "other programs take the processors: the daemon gets less than half of the processor time that it needs; end them, "
    "or give the service more (CPUWeight=, CPUAffinity=)"
)
_LEAST_SHARE = 0.05  # a thread that hangs is found after twenty times its deadline, however busy the machine is
_SAMPLE_NS = 1_000_000_000
_WINDOW = 5  # samples
_LONGEST_TURN_NS = 1_000_000_000
_LEAST_WAIT_NS = 50_000_000  # per second; shorter waits delay nothing noticeably
_PROC = Path("/proc")
_BUSY = (0, 1, 2, 5, 6, 7)  # user, nice, system, irq, softirq, steal in /proc/stat


@dataclass(frozen=True, slots=True)
class ProcessorTimes:
    """Times since some moment in the past, nanoseconds.

    Args:
        ran: on processors, by thread id; waited: ready to run, without a processor, by thread id.
        machine: all programs on the processors that this process may use.
    """

    ran: dict[int, int]
    waited: dict[int, int]
    machine: int


class ProcessorShare:
    """Measures the share once a second; :meth:`tick` is called by one thread, several times a second.

    Args:
        now_ns: monotonic time; read: returns the processor times, None where the system does not count them.
    """

    def __init__(
        self,
        now_ns: Callable[[], int] = time.monotonic_ns,
        read: Callable[[], ProcessorTimes | None] | None = None,
    ) -> None:
        self._now_ns, self._read = now_ns, read or read_processor_times
        self._tick_ns = self._sample_ns = now_ns()
        self._times = self._read()
        self._window: deque[tuple[int, int]] = deque(maxlen=_WINDOW)
        self._share, self._most_lost_ns = 1.0, 0
        #: Of the processor time that was wanted over the last seconds, 0 to 1; 1 where no thread had to wait.
        self.share = 1.0
        #: Time by which deadlines are extended: of each second the part in which the process was kept waiting.
        self.lost_ns = 0

    @property
    def scarce(self) -> bool:
        """Whether other programs leave this process less than half of the processor time that it needs."""
        return len(self._window) == _WINDOW and self.share < SCARCE

    def warnings(self) -> tuple[str, ...]:
        """For the status: that other programs take the processors; empty while they do not."""
        return (_WARNING,) if self.scarce else ()

    def tick(self) -> None:
        """Account for the time since the last call."""
        now_ns = self._now_ns()
        passed_ns, self._tick_ns = now_ns - self._tick_ns, now_ns
        # A turn that lasts longer than a second is itself a sign of a process that was stopped or kept waiting.
        late_ns = max(0, passed_ns - _LONGEST_TURN_NS)
        if now_ns - self._sample_ns >= _SAMPLE_NS:
            self._sample(now_ns)
        lost_ns = min(round((passed_ns - late_ns) * (1.0 - max(_LEAST_SHARE, self._share))), self._most_lost_ns)
        self._most_lost_ns -= lost_ns
        self.lost_ns += late_ns + lost_ns

    def as_dict(self) -> dict[str, float]:
        """Share over the last seconds and the time lost since the start, for the status."""
        return {"share": round(self.share, 3), "lost_s": round(self.lost_ns / 1e9, 1)}

    def _sample(self, now_ns: int) -> None:
        before, after = self._times, self._read()
        span_ns, self._sample_ns, self._times = now_ns - self._sample_ns, now_ns, after
        ran, taken = (0, 0) if before is None or after is None else _ran_and_taken(before, after)
        if taken * 1e9 < _LEAST_WAIT_NS * span_ns:
            taken = 0
        self._window.append((ran, taken))
        # The waits of all threads together bound what a chain of threads that wait for each other can have lost.
        self._share, self._most_lost_ns = _share(ran, taken), taken
        self.share = _share(sum(ran for ran, _ in self._window), sum(taken for _, taken in self._window))


def _ran_and_taken(before: ProcessorTimes, after: ProcessorTimes) -> tuple[int, int]:
    """Processor time of the process between two readings, and the part of its waits that other programs caused."""
    ran = sum(max(0, value - before.ran.get(thread, 0)) for thread, value in after.ran.items())
    waited = sum(max(0, value - before.waited.get(thread, 0)) for thread, value in after.waited.items())
    others = max(0, after.machine - before.machine - ran)
    return ran, round(waited * others / (others + ran)) if others else 0


def _share(ran: int, taken: int) -> float:
    return ran / (ran + taken) if taken else 1.0


def read_processor_times() -> ProcessorTimes | None:
    """Of this process and its children now; None where the system does not count them."""
    ran: dict[int, int] = {}
    waited: dict[int, int] = {}
    for thread in _threads():
        with suppress(OSError, ValueError):  # a thread may end meanwhile
            numbers = (thread / "schedstat").read_text().split()
            ran[int(thread.name)], waited[int(thread.name)] = int(numbers[0]), int(numbers[1])
    try:
        return ProcessorTimes(ran, waited, _machine_ns()) if ran else None
    except (OSError, ValueError, IndexError):
        return None


def _threads() -> Iterator[Path]:
    """Directories of all threads of this process and of its children."""
    processes, seen = [str(os.getpid())], set[str]()
    while processes:
        process = processes.pop()
        seen.add(process)
        with suppress(OSError):
            for thread in (_PROC / process / "task").iterdir():
                yield thread
                with suppress(OSError):
                    processes += [child for child in (thread / "children").read_text().split() if child not in seen]


def _machine_ns() -> int:
    """Processor time of all programs on the processors that this thread may use."""
    allowed = {f"cpu{number}" for number in os.sched_getaffinity(0)}
    rows = (row.split() for row in (_PROC / "stat").read_text().splitlines())
    ticks = sum(int(row[1 + column]) for row in rows if row[0] in allowed for column in _BUSY)
    return ticks * 1_000_000_000 // os.sysconf("SC_CLK_TCK")
