"""The interfaces of cameras and projectors, real or simulated.

A camera is read by one thread of the daemon, which owns it from ``open`` to ``close``::

    closed --open--> idle --start--> acquiring --stop--> idle --close--> closed
                                     |  read() -> Frame | None
                                     +- DeviceLost -> closed; open again to recover

Times are CLOCK_REALTIME nanoseconds. Trigger numbers are unsigned 32-bit and may wrap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
TRIGGER_MODULUS = 1 << 32
FlipSource = Literal["present", "vblank", "unverified"]


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One image as the sensor delivered it.

    Args:
        side: which camera.
        trigger: number of the trigger pulse that started the exposure, 0 .. 2**32 - 1.
        t_exposure_ns: start of exposure, as exactly as the driver can give it.
        t_host_ns: when the host had the whole frame.
        encoding: ``rgb8``, ``bayer_rggb8`` (and the other three), ``mono8``, ``mono16``.
        image: (H, W) or (H, W, 3), uint8 or uint16, read-only; never overwritten afterwards.
        exposure_us: exposure time that the camera used, 0 if unknown.
        t_device_ns: start of exposure on the camera's own clock, None if it has none.
        frame_id: the camera's own number of the frame, None if it has none.
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
    """Properties of a camera, known once it is open.

    Args:
        size: (width, height), pixels; encoding: as in :class:`Frame`.
        exposure_us: exposure time that it uses, 0 if unknown.
        notes: each setting that was rejected or rounded, in a sentence.
    """

    model: str
    serial: str
    size: tuple[int, int]
    encoding: str
    exposure_us: float = 0.0
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class CameraHealth:
    """Condition of a camera: its temperature, None if unknown, and its counters since the daemon started.

    ``counters`` hold every frame that was lost in the camera or the driver, by reason (``incomplete``, ``no_buffer``,
    ``missed_trigger``, ...), and whatever else the driver counts.
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
        """Release the device; never raises, may be called twice."""

    def health(self) -> CameraHealth:
        """Condition of the camera, in any state and from any thread; returns at once."""


@runtime_checkable
class FillsBuffers(Protocol):
    """A camera that writes its images into memory of the caller."""

    allocate: Callable[..., Any]
    """Returns the array for an image, from its shape and dtype."""


@dataclass(frozen=True, slots=True)
class ProjectorInfo:
    """Properties of a projector, known once it is open.

    Args:
        refresh_hz: 0 if unknown; latency_s: from flip to light, None if it was never measured.
        fixed_image: whether it shows an image of its own, whatever :meth:`Projector.show` is given.
    """

    output: str
    size: tuple[int, int]
    refresh_hz: float
    latency_s: float | None = None
    fixed_image: bool = False


@dataclass(frozen=True, slots=True)
class Flip:
    """When an image was out, that is, when the graphics card began to send it.

    Args:
        t_monotonic_ns, t_realtime_ns: the same instant on both clocks.
        msc: number of the vertical blank, 0 if unknown.
        source: ``present`` = the server reported this very image; ``vblank`` = first vertical blank after it was
            drawn; ``unverified`` = the server reports no time, this is when drawing ended.
    """

    t_monotonic_ns: int
    t_realtime_ns: int
    msc: int
    source: FlipSource


@runtime_checkable
class Projector(Protocol):
    """A projector that shows images pixel by pixel; it recovers by itself and then shows the last image again."""

    def open(self) -> ProjectorInfo:
        """Connect; raises DriverError when the output is not there or its mode does not fit."""

    def show(self, image: NDArray[np.uint8]) -> Flip | None:
        """Show an (H, W, 3) uint8 image of the projector's size until the next call; None where the flip is unknown."""

    def problem(self) -> str:
        """Why the last image may not be shown at this moment, empty when all is well; returns at once."""

    def close(self) -> None:
        """Go dark and release the output; never raises."""


@runtime_checkable
class StoresImages(Protocol):
    """A projector that can be given the images of a sequence, to show one at each trigger."""

    def store(self, images: Sequence[NDArray[np.uint8]], first: int = 0) -> None:
        """Show these from now on, the first of them at trigger ``first``."""


@runtime_checkable
class CountsShown(Protocol):
    """A projector that counts events of its output."""

    @property
    def counted(self) -> Mapping[str, int]:
        """Among them ``restarts``: how often the output was opened again since :meth:`Projector.open`."""


class MovesBoard(Protocol):
    """What moves the board of a simulated rig; in front of a real rig a person does."""

    def next_pose(self) -> object:
        """Move the board to its next pose; returns the pose, the same one again after the last."""


class Devices(Protocol):
    """The devices of a rig, closed."""

    @property
    def cameras(self) -> Mapping[Side, Camera]:
        """Left and right."""

    @property
    def projector(self) -> Projector:
        """Of the rig."""

    @property
    def board(self) -> MovesBoard | None:
        """Of a simulated rig."""

    def close(self) -> None:
        """Close all of them."""


class Clock(Protocol):
    """The daemon's time, injected so that tests need not sleep."""

    def realtime_ns(self) -> int:
        """CLOCK_REALTIME, nanoseconds."""

    def monotonic_ns(self) -> int:
        """CLOCK_MONOTONIC, nanoseconds."""
