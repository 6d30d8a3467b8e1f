"""A camera's cable whose next edges can be dropped or doubled."""

from __future__ import annotations

import threading
import time
from typing import Any

from sim.gentl.cable import Cable


class TamperedCable:
    """A cable of the world; everything but its edges goes through unchanged."""

    def __init__(self, cable: Cable) -> None:
        self._cable = cable
        self._lock = threading.Lock()
        self._swallow = self._double = 0

    def swallow(self, edges: int) -> None:
        """So many next edges never reach the camera."""
        with self._lock:
            self._swallow += edges

    def double(self, edges: int) -> None:
        """So many next edges come twice, the second while the sensor is busy."""
        with self._lock:
            self._double += edges

    def pulse(self, t_ns: int | None = None) -> object:
        """An edge, unless it is swallowed."""
        with self._lock:
            if self._swallow:
                self._swallow -= 1
                return False
            twice = self._double > 0
            self._double -= twice
        done = self._cable.pulse(t_ns)
        if twice:
            self._cable.pulse((time.monotonic_ns() if t_ns is None else t_ns) + 1000)
        return done

    def __getattr__(self, name: str) -> Any:
        return getattr(self._cable, name)
