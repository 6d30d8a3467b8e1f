"""An open video device: its identity, pixel formats, sizes and frame rate, and its errors as messages."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import NoReturn, TypeVar

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.v4l2 import structs as v
from drivers.v4l2.kernel import Argument, Kernel

_ENTRIES = 256
"""Limit of a device's lists."""

_GONE = (errno.ENODEV, errno.ENXIO)
_Structure = TypeVar("_Structure", bound=ctypes.Structure)


@dataclass(frozen=True, slots=True)
class SupportedFormat:
    """A pixel format of a device; sizes are (width, height), or (smallest, largest) if they are in steps."""

    fourcc: str
    description: str
    sizes: tuple[tuple[int, int], ...] = ()
    stepwise: bool = False

    def __str__(self) -> str:
        """Format as ``YUYV 640x480, 1280x720``, for error messages."""
        listed = [f"{width}x{height}" for width, height in self.sizes[:12]]
        sizes = " to ".join(listed) if self.stepwise else ", ".join(listed)
        return f"{self.fourcc} {sizes}".strip() + (", ..." if len(self.sizes) > 12 else "")


class Device:
    """A video device, open from construction to ``close``.

    Args:
        name: for messages ("camera left"); path: device file.

    Raises:
        DeviceLost: the file does not exist. DriverError: it cannot be opened, or is not a supported camera.
    """

    def __init__(self, kernel: Kernel, path: str, name: str) -> None:
        self.kernel, self.path, self.name = kernel, path, name
        try:
            self._fd: int | None = kernel.open(path)
        except OSError as error:
            raise self._cannot_open(error) from error
        try:
            capability = v.Capability()
            self.request(v.QUERYCAP, capability, "querying its capabilities")
        except DriverError:
            self.close()
            raise
        self.card, self.driver, self.bus = (
            bytes(field).decode("utf-8", "replace").strip()
            for field in (capability.card, capability.driver, capability.bus_info)
        )
        own = capability.capabilities & v.CAP_DEVICE_CAPS
        self.capabilities: int = capability.device_caps if own else capability.capabilities

    @property
    def fd(self) -> int:
        """The file descriptor; DeviceLost once closed."""
        if self._fd is None:
            raise DeviceLost(f"{self.name}: {self.path} is closed; open it again")
        return self._fd

    def close(self) -> None:
        """Close the descriptor; may be called twice."""
        fd, self._fd = self._fd, None
        if fd is not None:
            with contextlib.suppress(OSError):  # the device may be gone
                self.kernel.close(fd)

    def check_capture(self) -> None:
        """Raise DriverError unless this is a single-planar camera with mapped buffers."""
        if not self.capabilities & v.CAP_VIDEO_CAPTURE:
            if self.capabilities & v.CAP_VIDEO_CAPTURE_MPLANE:
                raise DriverError(
                    f"{self.name}: {self.path} ({self.card}) is a multi-planar device, which is not supported;"
                    " use a camera that offers single-planar capture (USB cameras do)"
                )
            raise DriverError(
                f"{self.name}: {self.path} ({self.card}) has no image capture; a camera often has a second device file"
                " for metadata only, use the other one"
            )
        if not self.capabilities & v.CAP_STREAMING:
            raise DriverError(f"{self.name}: {self.path} ({self.card}) cannot map its buffers (no streaming capture)")

    def request(self, number: int, argument: Argument, action: str) -> None:
        """Execute a request; DeviceLost when the device is gone, else DriverError with the action."""
        try:
            self.kernel.ioctl(self.fd, number, argument)
        except OSError as error:
            self.fail(error, action)

    def fail(self, error: OSError, action: str) -> NoReturn:
        """Raise the driver's error for an error of the kernel."""
        if error.errno in _GONE:
            raise DeviceLost(f"{self.name}: {self.path} was unplugged (while {action}); plug it in again") from error
        if error.errno == errno.EBUSY:
            raise DriverError(
                f"{self.name}: {self.path} is used by another program (while {action}); end it"
            ) from error
        if error.errno == errno.ENOSPC:
            raise DriverError(
                f"{self.name}: the USB bus has not enough bandwidth left (while {action}); plug the cameras into"
                " ports of different controllers, or choose a smaller size, a lower frame rate or a compressed format"
            ) from error
        raise DriverError(f"{self.name}: {self.path} failed while {action}: {_message(error)}") from error

    def listed(self, number: int, make: Callable[[int], _Structure]) -> Iterator[_Structure]:
        """Yield the entries of one of the kernel's lists, up to its end."""
        for index in range(_ENTRIES):
            entry = make(index)
            try:
                self.kernel.ioctl(self.fd, number, entry)
            except OSError as error:
                if error.errno in (errno.EINVAL, errno.ENOTTY):
                    return
                self.fail(error, "listing what it offers")
            yield entry

    def formats(self) -> tuple[SupportedFormat, ...]:
        """Return the pixel formats and their sizes."""
        entries = self.listed(v.ENUM_FMT, lambda index: v.FormatDescription(index=index, type=v.VIDEO_CAPTURE))
        return tuple(self._described(entry) for entry in entries)

    def _described(self, entry: v.FormatDescription) -> SupportedFormat:
        make: Callable[[int], v.FrameSize] = lambda i: v.FrameSize(index=i, pixel_format=entry.pixelformat)  # noqa: E731
        sizes: list[tuple[int, int]] = []
        stepwise = False
        for size in self.listed(v.ENUM_FRAMESIZES, make):
            if size.type == v.FRAME_SIZE_DISCRETE:
                sizes.append((size.discrete.width, size.discrete.height))
                continue
            steps, stepwise = size.stepwise, True
            sizes += [(steps.min_width, steps.min_height), (steps.max_width, steps.max_height)]
            break
        text = bytes(entry.description).decode("ascii", "replace")
        return SupportedFormat(v.fourcc_name(entry.pixelformat), text, tuple(sizes), stepwise)

    def current_format(self) -> v.PixelFormat:
        """Return the present size and layout."""
        form = v.Format(type=v.VIDEO_CAPTURE)
        self.request(v.G_FMT, form, "asking for its format")
        return v.PixelFormat.from_buffer_copy(form.fmt.pix)

    def set_format(self, fourcc: str, size: tuple[int, int]) -> v.PixelFormat:
        """Set pixel format and size; SettingRefused when the device uses others."""
        form = v.Format(type=v.VIDEO_CAPTURE)
        pix = form.fmt.pix
        (pix.width, pix.height), pix.pixelformat, pix.field = size, v.fourcc(fourcc), v.FIELD_NONE
        self.request(v.S_FMT, form, f"setting {fourcc} {size[0]}x{size[1]}")
        if (pix.width, pix.height) != size or pix.pixelformat != v.fourcc(fourcc):
            offered = "; ".join(map(str, self.formats()))
            raise SettingRefused(
                f"{self.name}: {self.path} does not support {fourcc} {size[0]}x{size[1]}, it proposes"
                f" {v.fourcc_name(pix.pixelformat)} {pix.width}x{pix.height}; there are: {offered}"
            )
        return v.PixelFormat.from_buffer_copy(pix)

    def set_frame_rate(self, rate_hz: float) -> float | None:
        """Set the frame rate; return the actual one, or None where it cannot be set."""
        parameters = v.StreamParameters(type=v.VIDEO_CAPTURE)
        try:
            self.kernel.ioctl(self.fd, v.G_PARM, parameters)
            if not parameters.parm.capture.capability & v.CAP_TIMEPERFRAME:
                return None
            interval = parameters.parm.capture.timeperframe
            interval.numerator, interval.denominator = 1000, round(1000 * rate_hz)
            self.kernel.ioctl(self.fd, v.S_PARM, parameters)
        except OSError as error:
            if error.errno in _GONE:
                self.fail(error, "setting the frame rate")
            return None
        return float(interval.denominator / interval.numerator) if interval.numerator else None

    def _cannot_open(self, error: OSError) -> DriverError:
        if error.errno in (errno.ENOENT, *_GONE):
            return DeviceLost(f"{self.name}: there is no {self.path}; plug the camera in, or correct its device")
        if error.errno in (errno.EACCES, errno.EPERM):
            return DriverError(f"{self.name}: no permission for {self.path}; add this user to the group 'video'")
        return DriverError(f"{self.name}: {self.path} cannot be opened: {_message(error)}")


def _message(error: OSError) -> str:
    code = errno.errorcode.get(error.errno or 0, str(error.errno))
    return f"{os.strerror(error.errno or 0)} ({code})"
