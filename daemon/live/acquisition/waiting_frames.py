"""Frames of one camera that wait for their partners, and those it had before."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

from drivers.protocols import TRIGGER_MODULUS, Frame


@dataclass(slots=True, eq=False)
class WaitingFrame:
    """A frame that waits for its partner, and how far the criteria of a pair hold."""

    frame: Frame
    number: int
    arrived_ns: int
    same_time: bool = False
    same_number: bool = False
    agreed: bool = False
    ambiguous: bool = False

    @property
    def numbered(self) -> Frame:
        """The frame with its number on the common count."""
        return self.frame if self.frame.trigger == self.number else replace(self.frame, trigger=self.number)


@dataclass(slots=True, eq=False)
class CameraHistory:
    """One side's waiting frames, its history, and what to add to its trigger numbers."""

    shift: int = 0
    waiting: list[WaitingFrame] = field(default_factory=list)
    history: deque[tuple[int, int]] = field(default_factory=deque)
    expired: deque[tuple[int, int]] = field(default_factory=deque)
    last_paired: int | None = None

    def move(self, by: int) -> None:
        """Shift the count from here on, waiting frames included."""
        self.shift = (self.shift + by) % TRIGGER_MODULUS
        for entry in self.waiting:
            entry.number = (entry.number + by) % TRIGGER_MODULUS
