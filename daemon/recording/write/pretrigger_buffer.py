"""The last seconds of raw frames, kept in memory so that a take can begin before its trigger."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from daemon.live.items import Pair
from daemon.recording.write.frame_queue import RawItem

MEGABYTE = 1_000_000


class PretriggerBuffer:
    """A ring buffer of pairs and unpaired frames, by reference; not thread-safe.

    Args:
        limits: returns the seconds (0: nothing is kept) and bytes to keep at most.
        now_ns: a clock that never goes back.
    """

    def __init__(self, limits: Callable[[], tuple[float, int]], now_ns: Callable[[], int]) -> None:
        self._limits, self._now_ns = limits, now_ns
        self._items: deque[tuple[int, int, RawItem]] = deque()
        self._bytes = 0

    def add(self, item: RawItem) -> None:
        """Add an item and remove those beyond the limits."""
        seconds, most_bytes = self._limits()
        if seconds <= 0:
            self.clear()
            return
        size, now_ns = size_of(item), self._now_ns()
        self._items.append((now_ns, size, item))
        self._bytes += size
        while self._items and (self._bytes > most_bytes or now_ns - self._items[0][0] > 1e9 * seconds):
            self._bytes -= self._items.popleft()[1]

    def last(self, seconds: float) -> list[RawItem]:
        """Return the items of the last seconds, oldest first."""
        since_ns = self._now_ns() - round(1e9 * seconds)
        return [item for t_ns, _, item in self._items if t_ns >= since_ns]

    def clear(self) -> None:
        """Remove all items."""
        self._items.clear()
        self._bytes = 0

    def status(self) -> dict[str, Any]:
        """Return how much is kept and how far back it reaches."""
        reach_s = (self._now_ns() - self._items[0][0]) / 1e9 if self._items else 0.0
        return {"kept_s": round(reach_s, 2), "items": len(self._items), "bytes": self._bytes}


def size_of(item: RawItem) -> int:
    """Return the bytes of an item's images."""
    if isinstance(item, Pair):
        return item.left.image.nbytes + item.right.image.nbytes
    return item.frame.image.nbytes
