"""A bounded queue in which the newest wins: putting never waits, and what is pushed out is returned."""

from __future__ import annotations

import threading
from collections import deque
from typing import Generic, TypeVar

T = TypeVar("T")


class LatestWinsQueue(Generic[T]):
    """A queue of at most ``capacity`` items between threads."""

    def __init__(self, capacity: int = 1) -> None:
        self.capacity = capacity
        self._items: deque[T] = deque()
        self._changed = threading.Condition()
        self._closed = False

    def __len__(self) -> int:
        return len(self._items)

    def put(self, item: T) -> T | None:
        """Add an item; returns the one that had to go: the oldest, or the item itself once closed."""
        with self._changed:
            if self._closed:
                return item
            pushed_out = self._items.popleft() if len(self._items) >= self.capacity else None
            self._items.append(item)
            self._changed.notify()
            return pushed_out

    def get(self, timeout_s: float) -> T | None:
        """The oldest item, or None when none came in time or the queue is closed and empty."""
        with self._changed:
            self._changed.wait_for(lambda: self._items or self._closed, timeout_s)
            return self._items.popleft() if self._items else None

    def clear(self) -> None:
        """Remove all items."""
        with self._changed:
            self._items.clear()

    def close(self) -> list[T]:
        """Take no more; returns the items that were left."""
        with self._changed:
            self._closed = True
            left = list(self._items)
            self._items.clear()
            self._changed.notify_all()
            return left
