"""Assembly of image sets: one pair for each frame of the sequence, by trigger number, never by order of arrival.

Pure logic: no threads and no clock. The pair of number ``first + k * frames + i`` shows frame i of set k. A set is
complete when all its pairs are there and their exposures began in the order of the sequence; a set that misses one, or
holds one that contradicts another, is dropped whole and counted. A pair is in one set at most, so a lost frame costs
its set and never mixes two.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from drivers.protocols import TRIGGER_MODULUS

T = TypeVar("T")

MAX_GAP_NS = 60_000_000_000
"""Pairs of one set are never further apart; otherwise the counter restarted in between."""

_HALF = TRIGGER_MODULUS // 2
_OPEN_SETS = 2


@dataclass(slots=True)
class _Open(Generic[T]):
    """An incomplete set: its members and their exposure times by index."""

    members: dict[int, T] = field(default_factory=dict)
    times_ns: dict[int, int] = field(default_factory=dict)
    invalid: bool = False

    def take(self, index: int, t_ns: int, member: T) -> None:
        """Add a pair; a second one of the same frame is ignored, or invalidates the set if it is another exposure."""
        if index not in self.members:
            self.members[index], self.times_ns[index] = member, t_ns
        elif self.times_ns[index] != t_ns:
            self.invalid = True

    def in_order(self) -> bool:
        """Whether the exposures began in the order of the sequence, without a long pause."""
        times_ns = [self.times_ns[index] for index in sorted(self.times_ns)]
        gaps = [after - before for before, after in itertools.pairwise(times_ns)]
        return all(0 < gap <= MAX_GAP_NS for gap in gaps)


class SetAssembler(Generic[T]):
    """Takes pairs; returns complete sets.

    Args:
        frames: of the sequence; first: number of a trigger that shows its first frame.
    """

    def __init__(self, frames: int, first: int = 0) -> None:
        if frames < 1:
            raise ValueError(f"a set has {frames} frames; expected 1 or more")
        self.frames, self._first = frames, first
        self.complete, self.incomplete, self.restarts = 0, 0, 0
        self._open: dict[int, _Open[T]] = {}
        self._newest: tuple[int, int] | None = None  # number and position of the newest pair
        self._decided: int | None = None  # the newest set that was handed over or dropped

    def feed(self, number: int, t_ns: int, member: T) -> tuple[T, ...] | None:
        """Take a pair; returns the set that it completes, in the order of the sequence.

        Args:
            number: of the trigger, may wrap; t_ns: start of exposure.
        """
        which, index = divmod(self._position(number), self.frames)
        if self._decided is not None and which <= self._decided:
            return None  # its set is decided already
        self._open.setdefault(which, _Open()).take(index, t_ns, member)
        if len(self._open[which].members) == self.frames:
            return self._finish(which)
        self._drop_until(which - _OPEN_SETS)
        return None

    def flush(self) -> None:
        """End: count what is incomplete."""
        self.incomplete += len(self._open)
        self._open.clear()

    def _position(self, number: int) -> int:
        """Triggers after the first frame's, negative before it, without the wrap of the numbers."""
        last, position = self._newest or (self._first, 0)
        step = (number - last + _HALF) % TRIGGER_MODULUS - _HALF
        if self._newest is not None and position + step < position - _OPEN_SETS * self.frames:
            # The counter restarted: no open set can be completed.
            self.flush()
            self.restarts += 1
            self._decided = None
            position, step = 0, (number - self._first + _HALF) % TRIGGER_MODULUS - _HALF
            self._newest = None
        position += step
        if self._newest is None or step > 0:
            self._newest = number, position
        return position

    def _finish(self, which: int) -> tuple[T, ...] | None:
        done = self._open.pop(which)
        self._drop_until(which)
        self._decided = which
        if done.invalid or not done.in_order():
            self.incomplete += 1
            return None
        self.complete += 1
        return tuple(done.members[index] for index in range(self.frames))

    def _drop_until(self, which: int) -> None:
        """Drop the open sets up to this one."""
        for old in [old for old in self._open if old <= which]:
            del self._open[old]
            self.incomplete += 1
            self._decided = old if self._decided is None else max(self._decided, old)
