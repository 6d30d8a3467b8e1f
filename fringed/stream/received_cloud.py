"""A received cloud, and how it is made of a message."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fringed import wire
from fringed.errors import WireError
from fringed.parts import BASIC, PARTS


@dataclass(frozen=True, slots=True, eq=False)
class ReceivedCloud:
    """A received cloud on the left camera's pixel grid; the arrays are read-only.

    Args:
        header: sequence number, time, session, calibration and statistics.
        xyz: (H, W, 3) float32, mm, NaN where there is no point.
        gray: (H, W) uint8, the texture; None on ``cloud/depth``.
        sigma: (H, W) float32, mm, one standard deviation along the viewing ray; None on ``cloud/depth``.
        rgb: (H, W, 3) uint8, colour without fringes, linear; normals: (H, W, 3) float32, unit vectors towards the
            camera, NaN where unknown; interpolated: (H, W) bool, points that were filled in, not measured. All None
            unless they were asked for (``parts``) or the daemon adds them to every cloud.
    """

    header: wire.CloudHeader
    xyz: NDArray[np.float32]
    gray: NDArray[np.uint8] | None
    sigma: NDArray[np.float32] | None
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    interpolated: NDArray[np.bool_] | None = None

    @property
    def every(self) -> int:
        """Spacing of the measured pixels: 2 means every second row and column of the camera, under load."""
        return _every(self.header)

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Mask of the pixels with a point, (H, W)."""
        return np.isfinite(self.xyz[..., 2])

    @property
    def points(self) -> NDArray[np.float32]:
        """The valid points, (N, 3), mm."""
        return self.xyz[self.valid]


def full_cloud(message: wire.Message, parts: Iterable[str] = BASIC) -> ReceivedCloud:
    """Return the cloud in a message of ``cloud/full``, or of a topic that asks for parts.

    Args:
        parts: that it must have; what the daemon adds is checked as well.

    Raises:
        WireError: another kind of message, or a part that is missing or of another type or shape.
    """
    header, arrays = cloud_header(message), message.arrays
    grid, wanted = (header.height, header.width), set(parts)
    names = [name for name in PARTS if name in arrays or name in wanted]
    _check(message, {name: (PARTS[name][0], (*grid, *PARTS[name][1])) for name in names})
    values: dict[str, Any] = dict.fromkeys(PARTS) | {name: arrays[name] for name in names}
    if values["interpolated"] is not None:
        values["interpolated"] = values["interpolated"].view(np.bool_)
    return ReceivedCloud(header, **values)


def depth_cloud(message: wire.Message, rays: wire.Message | None) -> ReceivedCloud | None:
    """Return the cloud in a message of ``cloud/depth``: xyz = z * (rx, ry, 1), NaN where the stored number is 0.

    Args:
        rays: the message of ``meta/rays`` with the cloud's rays, see :func:`rays_of`; None when it has not come yet:
            the message is checked, and there is no cloud.

    Raises:
        WireError: another kind of message, or its part is missing, of another type or shape, or without a scale.
    """
    header = cloud_header(message)
    _check(message, {"z": ("<u2", (header.height, header.width))})
    if rays is None:
        return None
    part, stored = message.part("z"), message.arrays["z"]
    if not isinstance(part.scale, float) or not isinstance(part.offset, float):
        raise WireError(f"{message.topic}: part 'z' needs scale and offset")
    z = stored * np.float32(part.scale) + np.float32(part.offset)
    z[stored == 0] = np.nan
    xyz = np.empty((*z.shape, 3), np.float32)
    np.multiply(rays_of(rays, header), z[..., None], out=xyz[..., :2])
    xyz[..., 2] = z
    xyz.setflags(write=False)
    return ReceivedCloud(header, xyz, None, None)


def rays_of(rays: wire.Message, header: wire.CloudHeader) -> NDArray[np.float32]:
    """Return the rays of a cloud's pixels, (height, width, 2) if the calibrations match."""
    array = rays.arrays["rays"]
    if array.shape[:2] != (header.height, header.width):
        every = _every(header)
        return array[::every, ::every]
    return array


def cloud_header(message: wire.Message) -> wire.CloudHeader:
    """Return the header of a cloud's message; WireError for another kind."""
    if not isinstance(message.header, wire.CloudHeader):
        raise WireError(f"{message.topic}: kind {message.header.kind!r}, expected 'cloud'")
    return message.header


def _check(message: wire.Message, expected: dict[str, tuple[str, tuple[int, ...]]]) -> None:
    for name, (dtype, shape) in expected.items():
        array = message.arrays.get(name)
        if array is None or array.dtype.str != dtype or array.shape != shape:
            actual = "is missing" if array is None else f"is {array.dtype.str} {list(array.shape)}"
            raise WireError(f"{message.topic}: part {name!r} {actual}, expected {dtype} {list(shape)}")


def _every(header: wire.CloudHeader) -> int:
    every = header.stats.get("every", 1)
    return every if isinstance(every, int) and every > 0 else 1
