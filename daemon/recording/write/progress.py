"""Progress of a take: counts and problems, set by the writing thread and read by any."""

from __future__ import annotations

import threading
from typing import Any

from daemon.recording.write.disk_sync import WritePosition
from drivers.protocols import Frame


class Progress:
    """Counts of a take; ``position`` is how far it is written."""

    def __init__(self) -> None:
        self.position = WritePosition()
        self.problem: str | None = None
        self.failed = False
        self._pairs = self._unpaired_frames = self._bytes = 0
        self._interruptions = self._unsynced_pairs = self._accounted = 0
        self._lock = threading.Lock()

    def wrote(self, frames: tuple[Frame, ...], size: int) -> None:
        """Count written frames of one number and their bytes."""
        with self._lock:
            self._bytes += size
            self._pairs += len(frames) == 2
            self._unpaired_frames += len(frames) == 1
            self.position = WritePosition(self._bytes, self._pairs, frames[0].trigger, frames[0].t_exposure_ns)

    def interrupted(self, problem: str) -> None:
        """Count an interruption by the disk; the take may resume."""
        with self._lock:
            self.problem = problem
            self._interruptions += 1

    def count_unsynced(self, synced: WritePosition) -> None:
        """Count the pairs written after ``synced``, which may be lost; none is counted twice."""
        with self._lock:
            self._unsynced_pairs += self.position.pairs - max(synced.pairs, self._accounted)
            self._accounted = self.position.pairs

    def fail(self, problem: str) -> None:
        """End the take with a problem; an earlier one is kept."""
        with self._lock:
            self.failed = True
            self.problem = self.problem or problem

    def status(self) -> dict[str, Any]:
        """Return the counts; rare ones only where they are not zero."""
        with self._lock:
            rare = {"interruptions": self._interruptions, "unsynced_pairs": self._unsynced_pairs}
            counts = {"pairs": self._pairs, "lone_frames": self._unpaired_frames, "bytes": self._bytes}
            return counts | {name: count for name, count in rare.items() if count}
