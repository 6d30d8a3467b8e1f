"""What waits for the disk: a bounded queue that never makes anybody wait, and counts whatever it does not take."""

from __future__ import annotations

import threading
from collections import Counter, deque
from collections.abc import Iterable

from daemon.live.items import PairItem, UnpairedFrame

Image = PairItem | UnpairedFrame


class Inbox:
    """A queue between the measuring threads and the one that writes.

    Args:
        capacity: items that may wait.
    """

    def __init__(self, capacity: int) -> None:
        self._capacity = capacity
        self._items: deque[Image] = deque()
        self._before = 0  # items of the time before the take: they need not fit
        self._changed = threading.Condition()
        self._closing = False
        self._full = "queue_full"
        self._over = ""
        self._dropped: Counter[str] = Counter()

    def __len__(self) -> int:
        return len(self._items)

    @property
    def closing(self) -> bool:
        """Whether nothing more will come."""
        return self._closing

    def offer(self, item: Image) -> bool:
        """Take an item, or count why not."""
        with self._changed:
            reason = self._over or ("closed" if self._closing else "")
            if not reason and len(self._items) >= self._capacity + self._before:
                reason = self._full
            if reason:
                self._dropped[reason] += 1
                return False
            self._items.append(item)
            self._changed.notify()
            return True

    def take_over(self, items: Iterable[Image]) -> None:
        """Items of the time before: they go first and need not fit."""
        with self._changed:
            before = list(items)
            self._items.extend(before)
            self._before += len(before)
            self._changed.notify()

    def next(self) -> Image | None:
        """The oldest item; waits for one. None once closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closing)
            self._before = max(0, self._before - 1)
            return self._items.popleft() if self._items else None

    def put_back(self, item: Image) -> None:
        """This one is to be the next again."""
        with self._changed:
            self._items.appendleft(item)

    def first(self) -> Image | None:
        """The oldest item, left where it is."""
        with self._changed:
            return self._items[0] if self._items else None

    def pause(self, timeout_s: float) -> None:
        """Wait so long, or until closed."""
        with self._changed:
            self._changed.wait_for(lambda: self._closing, timeout_s)

    def drop(self, reason: str, count: int = 1) -> None:
        """Count items that were taken and will not be written."""
        if count:
            with self._changed:
                self._dropped[reason] += count

    def no_disk(self, missing: bool) -> None:
        """While there is no disk, what does not fit is counted so."""
        self._full = "no_disk" if missing else "queue_full"

    def refuse(self, reason: str) -> None:
        """Take nothing more, for this reason; what waits is still to be written."""
        with self._changed:
            self._over = self._over or reason

    def close(self) -> None:
        """Take nothing more; who waits is woken."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()

    def clear(self, reason: str) -> None:
        """Nobody will write what waits: count it."""
        with self._changed:
            self._dropped[reason] += len(self._items)
            self._items.clear()

    def drops(self) -> dict[str, int]:
        """What was not written, by reason."""
        with self._changed:
            return {reason: count for reason, count in self._dropped.items() if count}
