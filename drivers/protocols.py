"""What every camera and projector offers, real or simulated.

A camera is read by one thread of the daemon, which owns it from ``open`` to ``close``::

    closed --open--> idle --start--> acquiring --stop--> idle --close--> closed
                                     |  read() -> Frame | None
                                     +- DeviceLost -> closed; open again to recover

Times are CLOCK_REALTIME nanoseconds. Trigger numbers are unsigned 32-bit and may wrap.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
TRIGGER_MODULUS = 1 << 32


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image as the sensor gave it.

    Args:
        side: which camera.
        trigger: number of the trigger pulse that started the exposure, 0 .. 2**32 - 1.
        t_exposure_ns: start of exposure as well as the driver knows it.
        t_host_ns: when the host had the whole frame.
        encoding: ``rgb8``, ``bayer_rggb8`` (and the other three), ``mono8``, ``mono16``.
        image: (H, W) or (H, W, 3), uint8 or uint16, read-only; never overwritten afterwards.
        exposure_us: exposure time that the camera took, 0 if unknown.
        t_device_ns: start of exposure on the camera's own clock, None if it has none.
        frame_id: the camera's own number of the frame, None if it gives none.
    """

    side: Side
    trigger: int
    t_exposure_ns: int
    t_host_ns: int
    encoding: str
    image: NDArray[np.uint8] | NDArray[np.uint16]
    exposure_us: float = 0.0
    t_device_ns: int | None = None
    frame_id: int | None = None


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """What a camera says of itself once it is open.

    Args:
        size: (width, height), pixels; encoding: as in :class:`Frame`.
        exposure_us: exposure time that it took, 0 if unknown.
        notes: each setting that was refused or rounded, in a sentence.
    """

    model: str
    serial: str
    size: tuple[int, int]
    encoding: str
    exposure_us: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """How a camera fares: its temperature, None if unknown, and what was counted since the daemon started.

    ``counters`` hold every frame that the driver knows of and never delivered, by reason (``incomplete``,
    ``no_buffer``, ``missed_trigger``, ...), and whatever else the driver counts.
    """

    temperature_c: float | None = None
    counters: Mapping[str, int] = field(default_factory=dict)


@runtime_checkable
class Camera(Protocol):
    """A triggered camera. ``open`` and ``read`` raise DeviceLost when the device is gone."""

    def open(self) -> CameraInfo:
        """Connect and set up; may be called again after DeviceLost."""

    def start(self) -> None:
        """Begin to accept triggers."""

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame in the order of arrival, or None when none came in time."""

    def stop(self) -> None:
        """Stop accepting triggers; frames not yet read are dropped."""

    def close(self) -> None:
        """Let go of the device; never raises, may be called twice."""

    def health(self) -> CameraHealth:
        """How it fares, in any state and from any thread; returns at once what is known."""


@dataclass(frozen=True, slots=True)
class ProjectorInfo:
    """What a projector says of itself; ``refresh_hz`` is 0 where it cannot be known."""

    output: str
    size: tuple[int, int]
    refresh_hz: float


@runtime_checkable
class Projector(Protocol):
    """A projector that shows images pixel by pixel; it recovers by itself and then shows the last image again."""

    def open(self) -> ProjectorInfo:
        """Connect; raises DriverError when the output is not there or its mode does not fit."""

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show an (H, W, 3) uint8 image of the projector's size until the next call."""

    def problem(self) -> str:
        """Why the last image may not be shown at this moment, empty when all is well; returns at once."""

    def close(self) -> None:
        """Go dark and let go; never raises."""


class Clock(Protocol):
    """Time as the daemon sees it, injected so that tests need not sleep."""

    def realtime_ns(self) -> int:
        """CLOCK_REALTIME, nanoseconds."""

    def monotonic_ns(self) -> int:
        """CLOCK_MONOTONIC, nanoseconds."""
