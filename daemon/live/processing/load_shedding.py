"""Load shedding: while pairs come faster than they are measured, every second pixel is measured instead of all."""

from __future__ import annotations

from collections import deque
from statistics import median_low

_WINDOW_NS = 1_000_000_000
_RECOVERY_NS = 3_000_000_000
_COMPARED = 9  # measurements whose median stands for the time that one takes
_BEHIND = 2  # measurements that pairs were dropped during; a single one may be a hiccup, or the first of all
_MAX_LOAD = 0.8  # share of the time that the full measurement may take, as predicted, to be resumed


class LoadShedding:
    """Decides from the drops of the last second, and from how long full and half measurements took.

    The stride becomes 2 when pairs were dropped during several measurements, and 1 again when nothing was dropped for
    some seconds and the full measurement would leave time to spare. Its time is predicted: as it was before, times the
    change of the half one since.

    Args:
        enabled: False = always the full image.
    """

    def __init__(self, *, enabled: bool) -> None:
        self._enabled = enabled
        self._offered: deque[int] = deque(maxlen=1024)
        self._dropped_ns: int | None = None
        self._behind: deque[int] = deque(maxlen=_BEHIND)
        self._dropped_meanwhile = False
        self._full_ms: deque[float] = deque(maxlen=_COMPARED)
        self._first_half_ms: list[float] = []
        self._half_ms: deque[float] = deque(maxlen=_COMPARED)
        self._since_ns = 0
        #: 1 = every pixel is measured, 2 = every second of both axes.
        self.stride = 1

    def enable(self, enabled: bool) -> None:
        """Allow half measurements from now on, or end them."""
        self._enabled = enabled
        if not enabled:
            self.stride = 1
            self._behind.clear()

    def offered(self, now_ns: int) -> None:
        """Note that a pair came."""
        self._offered.append(now_ns)

    def dropped(self, now_ns: int) -> None:
        """Note that a pair was dropped because the pipeline was busy."""
        self._dropped_ns, self._dropped_meanwhile = now_ns, True

    def measured(self, busy_ms: float, stride: int, now_ns: int) -> bool:
        """Note that a pair was measured; True when :attr:`stride` has changed."""
        if stride == 1:
            self._full_ms.append(busy_ms)
        else:
            self._half_ms.append(busy_ms)
            if len(self._first_half_ms) < _COMPARED:
                self._first_half_ms.append(busy_ms)
        if self._dropped_meanwhile:
            self._behind.append(now_ns)
            self._dropped_meanwhile = False
        before = self.stride
        if before == 1 and self._enabled and self._steadily_behind(now_ns):
            self.stride = 2
            self._half_ms.clear()
            self._first_half_ms.clear()
        elif before == 2 and self._has_capacity(now_ns):
            self.stride = 1
            self._behind.clear()
        if self.stride != before:
            self._since_ns = now_ns
        return self.stride != before

    def _steadily_behind(self, now_ns: int) -> bool:
        return sum(t_ns > now_ns - _WINDOW_NS for t_ns in self._behind) >= _BEHIND

    def _has_capacity(self, now_ns: int) -> bool:
        drop_free_since_ns = max(self._since_ns, self._dropped_ns or 0)
        if now_ns - drop_free_since_ns < _RECOVERY_NS:
            return False
        came = sum(t_ns > now_ns - _RECOVERY_NS for t_ns in self._offered)
        # The lower one of two: the very first measurement also calibrates itself and takes much longer.
        full_ms = median_low(self._full_ms) * median_low(self._half_ms) / median_low(self._first_half_ms)
        return came * full_ms < _MAX_LOAD * _RECOVERY_NS / 1e6
