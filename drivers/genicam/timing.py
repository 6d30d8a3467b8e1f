"""Exposure times of frames: the camera's time stamps mapped to the host's clock, with fall-backs where they lack.

The host's clock is CLOCK_MONOTONIC here: the mapping of a camera's clock stays valid when the time of day is set.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

from drivers.device_clock import DeviceClock
from drivers.genicam.features import GENICAM_ERRORS, LOSS, Features, device_lost_errors

_NS = 1_000_000_000
_LATCH_EVERY_NS = 400_000_000
_FIRST_LATCHES = 8
_SOON_NS, _OLD_NS = 5_000_000, 10 * _NS
_MOST_IMPLAUSIBLE = 5


@dataclass(frozen=True, slots=True)
class Exposure:
    """Start of a frame's exposure.

    Args:
        t_device_ns: on the camera's clock, None without a time stamp. t_ns: CLOCK_MONOTONIC.
    """

    t_device_ns: int | None
    t_ns: int


class Timing:
    """Follows one camera's clock.

    Args:
        camera: its features. offset_us: added to its time stamps to get the start of exposure.
    """

    def __init__(self, camera: Features, *, offset_us: float = 0.0) -> None:
        self._camera, self._offset_ns = camera, round(offset_us * 1000)
        self.clock = DeviceClock()
        self.without_stamp = 0
        self._hz = _tick_rate(camera)
        self._can_latch = camera.find("TimestampLatch") is not None and camera.find("TimestampLatchValue") is not None
        self._next_ns = 0
        self._implausible = 0

    @property
    def latches(self) -> bool:
        """Whether the camera's clock can be read."""
        return self._can_latch

    def follow(self, now_ns: int) -> bool:
        """Read the camera's clock if that is due; return whether it was read. ``now_ns`` is CLOCK_MONOTONIC."""
        if not self._can_latch or (now_ns < self._next_ns and self.clock.latched):
            return False
        self._latch_clock()
        self._next_ns = now_ns + _LATCH_EVERY_NS
        return True

    def exposure(self, buffer: Any, t_host_ns: int, exposure_us: float) -> Exposure:
        """Return the start of exposure of an image that came at ``t_host_ns``, CLOCK_MONOTONIC."""
        stamp = self._stamp(buffer)
        if stamp is None:
            self.without_stamp += 1
            return Exposure(None, t_host_ns - round(exposure_us * 1000))
        device_ns = stamp + self._offset_ns
        self.clock.arrival(device_ns, t_host_ns, delay_ns=round(exposure_us * 1000))
        if self._can_latch and not self.clock.latched:  # the clock was reset
            self._latch_clock()
        t_ns = self.clock.to_host_ns(device_ns)
        if self._can_latch and not t_host_ns - _OLD_NS < t_ns < t_host_ns + _SOON_NS:
            self._count_implausible()
            t_ns = t_host_ns - round(exposure_us * 1000)
        else:
            self._implausible = 0
        return Exposure(device_ns, min(t_ns, t_host_ns))

    def _count_implausible(self) -> None:
        """Ignore the latches after several implausible times: some cameras stamp images by another clock."""
        self._implausible += 1
        if self._implausible >= _MOST_IMPLAUSIBLE:
            self._can_latch, self.clock = False, DeviceClock()

    def _latch_clock(self) -> None:
        for _ in range(1 if self.clock.latched else _FIRST_LATCHES):
            self._latch()

    def _latch(self) -> None:
        with device_lost_errors("reading its clock"):
            before = time.monotonic_ns()
            self._camera.execute("TimestampLatch")
            after = time.monotonic_ns()
            value = self._camera.read("TimestampLatchValue")
        if value is not None and after >= before:
            self.clock.latch(before, _nanoseconds(int(value), self._hz), after)

    def _stamp(self, buffer: Any) -> int | None:
        """Return the image's time stamp in nanoseconds, None if there is none, or zero in its place."""
        stamp = _property(buffer, "timestamp_ns")
        if not stamp:
            ticks = _property(buffer, "timestamp") or self._camera.read("ChunkTimestamp")
            stamp = _nanoseconds(int(ticks), self._hz) if ticks else 0
        return int(stamp) or None


def _tick_rate(camera: Features) -> int:
    """Return the ticks a second of the camera's clock; modern cameras count nanoseconds."""
    return int(camera.read("TimestampTickFrequency") or 0) or _NS


def _nanoseconds(ticks: int, hz: int) -> int:
    return ticks if hz == _NS else ticks * _NS // hz


def _property(buffer: Any, name: str) -> Any:
    try:
        return getattr(buffer, name)  # a GenTL buffer: a property may raise
    except LOSS:
        raise
    except GENICAM_ERRORS:
        return None
