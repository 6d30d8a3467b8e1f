"""How far a take is: counts and troubles, told by the writing thread and read by any."""

from __future__ import annotations

import threading
from typing import Any

from daemon.recording.write.disk_sync import Mark
from drivers.protocols import Frame


class Progress:
    """Counts of a take; ``mark`` is how far it is written."""

    def __init__(self) -> None:
        self.mark = Mark()
        self.problem: str | None = None
        self.failed = False
        self._pairs = self._lone_frames = self._bytes = 0
        self._interruptions = self._unsynced_pairs = self._accounted = 0
        self._lock = threading.Lock()

    def wrote(self, frames: tuple[Frame, ...], size: int) -> None:
        """Frames of one number were written and took so many bytes."""
        with self._lock:
            self._bytes += size
            self._pairs += len(frames) == 2
            self._lone_frames += len(frames) == 1
            self.mark = Mark(self._bytes, self._pairs, frames[0].trigger, frames[0].t_exposure_ns)

    def interrupted(self, problem: str) -> None:
        """The disk is in trouble; the take may go on."""
        with self._lock:
            self.problem = problem
            self._interruptions += 1

    def unsure(self, synced: Mark) -> None:
        """What was written after ``synced`` may be lost; what was counted so before is not counted again."""
        with self._lock:
            self._unsynced_pairs += self.mark.pairs - max(synced.pairs, self._accounted)
            self._accounted = self.mark.pairs

    def fail(self, problem: str) -> None:
        """The take has ended; the first problem stands."""
        with self._lock:
            self.failed = True
            self.problem = self.problem or problem

    def status(self) -> dict[str, Any]:
        """The counts; rare ones only where they are not zero."""
        with self._lock:
            rare = {"interruptions": self._interruptions, "unsynced_pairs": self._unsynced_pairs}
            counts = {"pairs": self._pairs, "lone_frames": self._lone_frames, "bytes": self._bytes}
            return counts | {name: count for name, count in rare.items() if count}
