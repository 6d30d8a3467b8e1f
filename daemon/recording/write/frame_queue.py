"""The items that wait for the disk: a bounded queue that never blocks its producers and counts what it drops."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from daemon.live.items import Pair, UnpairedFrame

RawItem = Pair | UnpairedFrame


class FrameQueue:
    """A queue between the measuring threads and the writing one.

    Args:
        capacity: items that may wait.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[RawItem] = deque()
        self._early = 0  # items from before the take, beyond the capacity
        self._changed = threading.Condition()
        self._closing = False
        self._full = "queue_full"
        self._refusal = ""
        self._dropped: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._items)

    @property
    def closing(self) -> bool:
        """Whether no more items are accepted."""
        return self._closing

    def offer(self, item: RawItem) -> bool:
        """Add an item; where it is refused, count the reason and return False."""
        with self._changed:
            reason = self._refusal or ("closed" if self._closing else "")
            if not reason and len(self._items) >= self._capacity + self._early:
                reason = self._full
            if reason:
                self._dropped[reason] += 1
                return False
            self._items.append(item)
            self._changed.notify()
            return True

    def take_over(self, items: Iterable[RawItem]) -> None:
        """Add items from before the take; they are exempt from the capacity."""
        with self._changed:
            early = list(items)
            self._items.extend(early)
            self._early += len(early)
            self._changed.notify()

    def next(self) -> RawItem | None:
        """Remove and return the oldest item; wait for one. None once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closing)
            self._early = max(0, self._early - 1)
            return self._items.popleft() if self._items else None

    def put_back(self, item: RawItem) -> None:
        """Return an item to the front of the queue."""
        with self._changed:
            self._items.appendleft(item)

    def first(self) -> RawItem | None:
        """Return the oldest item without removing it."""
        with self._changed:
            return self._items[0] if self._items else None

    def pause(self, timeout_s: float) -> None:
        """Wait for the time-out, or until closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing, timeout_s)

    def drop(self, reason: str, count: int = 1) -> None:
        """Count accepted items that will not be written."""
        if count:
            with self._changed:
                self._dropped[reason] += count

    def set_disk_missing(self, missing: bool) -> None:
        """Count overflow as ``no_disk`` while there is no disk, else as ``queue_full``."""
        self._full = "no_disk" if missing else "queue_full"

    def refuse(self, reason: str) -> None:
        """Accept no more items, for this reason; those that wait are still to be written."""
        with self._changed:
            self._refusal = self._refusal or reason

    def close(self) -> None:
        """Accept no more items and wake the waiting threads."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def clear(self, reason: str) -> None:
        """Drop the waiting items and count them."""
        with self._changed:
            self._dropped[reason] += len(self._items)
            self._items.clear()

    def drops(self) -> dict[str, int]:
        """Return the counts of dropped items by reason."""
        with self._changed:
            return {reason: count for reason, count in self._dropped.items() if count}
