"""Control of Python's garbage collector, so that it does not delay measurements.

A collection stops every thread for as long as it takes: tens of milliseconds over all that a daemon has imported.
The objects that exist after the start are frozen, which takes them out of every later collection, and newer ones are
collected between two pairs: the young a little at a time, everything only when no pair waits.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Callable
from typing import Any

_YOUNG = 2000  # objects that a collection of the youngest generation waits for: 0.1 ms
_YOUNG_PER_MIDDLE = 10
_FULL_S, _OVERDUE_S = 60.0, 600.0


class GcPauses:
    """How often and how long collections stopped all threads, those of other callers included."""

    def __init__(self, now_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self._now_ns = now_ns
        self._began_ns = 0
        self._count, self._total_ms, self._max_ms = 0, 0.0, 0.0

    def start(self) -> None:
        """Begin to count."""
        gc.callbacks.append(self._note)

    def stop(self) -> None:
        """Stop counting; may be called twice."""
        if self._note in gc.callbacks:
            gc.callbacks.remove(self._note)

    def summary(self) -> dict[str, float]:
        """Number of collections, their total and longest time."""
        return {"count": self._count, "total_ms": round(self._total_ms, 3), "max_ms": round(self._max_ms, 3)}

    def _note(self, phase: str, _: dict[str, Any]) -> None:
        if phase == "start":
            self._began_ns = self._now_ns()
            return
        ms = (self._now_ns() - self._began_ns) / 1e6
        self._count, self._total_ms, self._max_ms = self._count + 1, self._total_ms + ms, max(self._max_ms, ms)


class GcControl:
    """Runs the collector instead of Python; call :meth:`between_pairs` often."""

    def __init__(self) -> None:
        self._active = False
        self._was_enabled = False
        self._young = 0
        self._full_due_s = 0.0

    def take_over(self, now_s: float) -> None:
        """Begin, or begin again after much has changed: collect everything, freeze the rest."""
        if not self._active:
            self._was_enabled = gc.isenabled()
        gc.disable()
        gc.unfreeze()
        gc.collect()
        gc.freeze()
        self._active, self._young, self._full_due_s = True, 0, now_s + _FULL_S

    def between_pairs(self, now_s: float, *, idle: bool) -> None:
        """Collect what is due; ``idle``: no pair waits, so that some milliseconds do not matter."""
        if not self._active:
            return
        late_s = now_s - self._full_due_s
        if late_s > _OVERDUE_S or (idle and late_s > 0):
            gc.collect()
            self._young, self._full_due_s = 0, now_s + _FULL_S
        elif gc.get_count()[0] >= _YOUNG:
            self._young += 1
            gc.collect(1 if self._young % _YOUNG_PER_MIDDLE == 0 else 0)

    def release(self) -> None:
        """Restore the collector; may be called twice."""
        if self._active:
            self._active = False
            gc.unfreeze()
            if self._was_enabled:
                gc.enable()
