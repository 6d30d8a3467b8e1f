"""A camera's clock against the host's: offset and drift from observations, with their uncertainty.

Pure logic without a clock of its own: the caller passes observations, of two kinds:

* a *latch*: the device's time read between two readings of the host's clock. The offset then lies within half the
  round trip of the middle, whatever the delays were. Short round trips count most.
* an *arrival*: a frame of a known device time reached the host. It cannot have come before it was exposed, so the
  true offset lies below every arrival: the line that touches the arrivals from below (Moon, Skelly, Towsley:
  Estimation and removal of clock skew from network delay measurements, INFOCOM 1999) follows the clock and ignores
  late frames. It includes the shortest delay, of which the caller subtracts the known part (the exposure time).

Where there are latches, only they count. The best observation of each second is kept for about a minute, so neither
memory nor time grows. A device clock that was reset, and a host clock that was stepped, contradict the observations:
all are discarded then (counted in ``resets``).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_SLOT_NS = 1_000_000_000
_SLOTS = 64
_MAX_DRIFT = 1e-3
"""Crystals keep 100 ppm; a slope beyond this is an error of the observations."""

_TOLERANCE_NS = 5_000_000
"""How far an observation may lie on the impossible side of the line before all are discarded."""

_LATE_NS = 20_000_000
_LATE_FOR_NS = 8_000_000_000
"""Frames this late for this long mean that the clock was set back."""

_DRIFT_SPAN_NS = 2_500_000_000
"""Observations over a shorter time than this do not determine the drift."""


@dataclass(frozen=True, slots=True)
class _Observation:
    device_ns: int
    offset_ns: int
    half_ns: int


@dataclass(frozen=True, slots=True)
class _Line:
    """``offset = at_ns + slope * (device - origin_ns)``."""

    origin_ns: int
    at_ns: float
    slope: float
    base_ns: int
    error_ns: float

    def offset(self, device_ns: int) -> int:
        return self.base_ns + round(self.at_ns + self.slope * (device_ns - self.origin_ns))


class _Track:
    """Observations of one kind and the line through them."""

    def __init__(self) -> None:
        self.kept: list[_Observation] = []
        self.line: _Line | None = None

    def keep(self, new: _Observation, *, better: bool) -> bool:
        """Store an observation in the slot of its second; return whether anything changed."""
        slot = new.device_ns // _SLOT_NS
        if self.kept and self.kept[-1].device_ns // _SLOT_NS == slot:
            if not better:
                return False
            self.kept[-1] = new
        else:
            self.kept.append(new)
            del self.kept[:-_SLOTS]
        return True

    def last_in_slot(self, device_ns: int) -> _Observation | None:
        """Return the observation in the slot of this time."""
        if self.kept and self.kept[-1].device_ns // _SLOT_NS == device_ns // _SLOT_NS:
            return self.kept[-1]
        return None

    def arrays(self) -> tuple[int, int, NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return origin, base, and the observations relative to them: device time, offset and half width, (N,)."""
        origin, base = self.kept[-1].device_ns, self.kept[-1].offset_ns
        table = np.array([(s.device_ns - origin, s.offset_ns - base, s.half_ns) for s in self.kept], np.float64)
        return origin, base, table[:, 0], table[:, 1], table[:, 2]


class DeviceClock:
    """Maps a device's time to the host's, both in nanoseconds."""

    def __init__(self) -> None:
        self.resets = 0
        self._latches, self._arrivals = _Track(), _Track()
        self._last_latch_ns = self._last_arrival_ns = -(1 << 63)
        self._late_since_ns: int | None = None
        self._latest_ns = 0

    @property
    def ready(self) -> bool:
        """Whether there is an observation."""
        return self._line() is not None

    @property
    def latched(self) -> bool:
        """Whether the mapping is based on latches."""
        return self._latches.line is not None

    def latch(self, before_ns: int, device_ns: int, after_ns: int) -> None:
        """Add a latch: the device's clock was ``device_ns`` between two times of the host."""
        half = max((after_ns - before_ns + 1) // 2, 1)
        new = _Observation(device_ns, (before_ns + after_ns) // 2 - device_ns, half)
        line = self._latches.line
        if device_ns < self._last_latch_ns or (line is not None and self._contradicts(line, new)):
            self._reset()
        self._last_latch_ns = device_ns
        self._latest_ns = max(self._latest_ns, device_ns)
        held = self._latches.last_in_slot(device_ns)
        if self._latches.keep(new, better=held is None or half <= held.half_ns):
            self._latches.line = _through(self._latches)

    def arrival(self, device_ns: int, host_ns: int, *, delay_ns: int = 0) -> None:
        """Add an arrival: a frame of that device time came at ``host_ns``; ``delay_ns`` of its delay are known."""
        offset = host_ns - delay_ns - device_ns
        if device_ns < self._last_arrival_ns:
            self._reset()
        elif (line := self._line()) is not None:
            behind = offset - line.offset(device_ns)
            # The first frames may all be late; an earlier one only corrects them.
            settled = self.latched or len(self._arrivals.kept) > 1
            early = settled and behind < -(_TOLERANCE_NS + line.error_ns)
            if early or self._always_late(behind, device_ns):
                self._reset()
        self._last_arrival_ns = device_ns
        self._latest_ns = max(self._latest_ns, device_ns)
        held = self._arrivals.last_in_slot(device_ns)
        if self._arrivals.keep(_Observation(device_ns, offset, 0), better=held is None or offset < held.offset_ns):
            self._arrivals.line = _below(self._arrivals)

    def to_host_ns(self, device_ns: int) -> int:
        """Return the host's time at a device's time; ValueError without an observation (see :attr:`ready`)."""
        line = self._line()
        if line is None:
            raise ValueError("there is no observation of the device's clock; add a latch or an arrival first")
        return device_ns + line.offset(device_ns)

    def uncertainty_ns(self, device_ns: int | None = None) -> int:
        """Return the uncertainty of :meth:`to_host_ns`; from arrivals alone, the shortest delay adds to it."""
        line = self._line()
        if line is None:
            raise ValueError("there is no observation of the device's clock; add a latch or an arrival first")
        at_ns = self._latest_ns if device_ns is None else device_ns
        known_drift = 10e-6 if self._span_ns() >= _DRIFT_SPAN_NS else 100e-6
        return round(line.error_ns + known_drift * abs(at_ns - line.origin_ns))

    def drift_ppm(self) -> float:
        """Return how much faster the host's clock runs than the device's, parts in a million."""
        line = self._line()
        return 0.0 if line is None else line.slope * 1e6

    def _line(self) -> _Line | None:
        return self._latches.line or self._arrivals.line

    def _span_ns(self) -> int:
        kept = (self._latches if self.latched else self._arrivals).kept
        return kept[-1].device_ns - kept[0].device_ns if kept else 0

    @staticmethod
    def _contradicts(line: _Line, new: _Observation) -> bool:
        away = abs(new.offset_ns - line.offset(new.device_ns))
        return away > new.half_ns + line.error_ns + _TOLERANCE_NS + _MAX_DRIFT * abs(new.device_ns - line.origin_ns)

    def _always_late(self, behind_ns: int, device_ns: int) -> bool:
        """Return whether all frames have been late for so long that the clock must have been set back."""
        if behind_ns < _LATE_NS:
            self._late_since_ns = None
            return False
        if self._late_since_ns is None:
            self._late_since_ns = device_ns
        return device_ns - self._late_since_ns > _LATE_FOR_NS

    def _reset(self) -> None:
        self.resets += 1
        self._latches, self._arrivals = _Track(), _Track()
        self._last_latch_ns = self._last_arrival_ns = -(1 << 63)
        self._late_since_ns = None
        self._latest_ns = 0


def _through(track: _Track) -> _Line:
    """Fit the weighted least-squares line through latches, weights by the square of the round trip."""
    origin, base, t, y, half = track.arrays()
    weight = 1.0 / half**2
    total = float(weight.sum())
    mean_t, mean_y = float(weight @ t) / total, float(weight @ y) / total
    spread = float(weight @ (t - mean_t) ** 2)
    slope = 0.0
    if t[-1] - t[0] >= _DRIFT_SPAN_NS and spread > 0:
        slope = float(weight @ ((t - mean_t) * (y - mean_y))) / spread
        slope = min(max(slope, -_MAX_DRIFT), _MAX_DRIFT)
    else:
        best = int(np.argmin(half))
        mean_t, mean_y = float(t[best]), float(y[best])
    residual = np.abs(y - mean_y - slope * (t - mean_t))
    error = float(half.min()) + min(float(np.median(residual)), float(half.max()))
    return _Line(origin, mean_y - slope * mean_t, slope, base, error)


def _below(track: _Track) -> _Line:
    """Fit the closest line below all arrivals: the edge of their lower hull under their mean time."""
    origin, base, t, y, _ = track.arrays()
    if t[-1] - t[0] < _DRIFT_SPAN_NS:
        low = int(np.argmin(y))
        return _Line(origin, float(y[low]), 0.0, base, float(np.median(y - y[low])))
    hull = _lower_hull(t, y)
    mean = float(t.mean())
    right = next(k for k in range(1, len(hull)) if t[hull[k]] >= mean or k == len(hull) - 1)
    a, b = hull[right - 1], hull[right]
    slope = min(max(float((y[b] - y[a]) / (t[b] - t[a])), -_MAX_DRIFT), _MAX_DRIFT)
    at = float(np.min(y - slope * t))
    return _Line(origin, at, slope, base, float(np.median(y - slope * t - at)))


def _lower_hull(t: NDArray[np.float64], y: NDArray[np.float64]) -> list[int]:
    """Return the corners of the lower convex hull, in the order of time (Andrew's monotone chain)."""
    hull: list[int] = []
    for i in range(len(t)):
        while len(hull) >= 2:
            a, b = hull[-2], hull[-1]
            if (y[b] - y[a]) * (t[i] - t[a]) >= (y[i] - y[a]) * (t[b] - t[a]):
                hull.pop()
            else:
                break
        hull.append(i)
    return hull


def period_ns(times_ns: list[int]) -> float | None:
    """Return the period of regular events (each interval a whole multiple of it), None if they are irregular.

    Args:
        times_ns: at least four times in their order.
    """
    if len(times_ns) < 4:
        return None
    steps = np.diff(np.array(times_ns, np.int64)).astype(np.float64)
    usual = float(np.median(steps))
    if usual <= 0:
        return None
    multiples = np.maximum(np.round(steps / usual), 1.0)
    off = np.abs(steps / multiples - usual)
    return usual if not math.isnan(usual) and float(np.quantile(off, 0.8)) < 0.1 * usual else None
