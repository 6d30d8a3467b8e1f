"""Colours of points, packed as 0xRRGGBBAA, which Rerun logs several times faster than rows of three."""

from __future__ import annotations

from functools import cache
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

Color = Literal["depth", "texture", "sigma", "rgb"]
COLORS: tuple[str, ...] = get_args(Color)

Packed = NDArray[np.uint32]

_DEPTH_STEP_MM, _SIGMA_STEP_MM = 10.0, 0.05
_SAMPLES = 20_000


def packed(
    color: str,
    *,
    z: NDArray[np.float32],
    gray: NDArray[np.uint8],
    sigma: NDArray[np.float32],
    rgb: NDArray[np.uint8] | None = None,
) -> Packed:
    """The colour of each point, (N,).

    Args:
        color: the encoded quantity; z, sigma: (N,), mm; gray: (N,) texture; rgb: (N, 3) its colours, shown twice as
            bright: a white surface has about half of full scale.

    Raises:
        ValueError: ``color`` is not one of COLORS.
    """
    if color == "rgb" and rgb is not None:
        red, green, blue = np.minimum(2 * rgb.astype(np.uint32), 255).T
        return np.asarray((red << 24) | (green << 16) | (blue << 8) | 0xFF, np.uint32)
    if color in ("texture", "rgb"):
        return np.asarray(gray.astype(np.uint32) * 0x01010100 + 0xFF, np.uint32)
    if color == "depth":
        return _ramp(z, *bounds(z, _DEPTH_STEP_MM))
    if color == "sigma":
        return _ramp(sigma, 0.0, bounds(sigma, _SIGMA_STEP_MM)[1])
    raise ValueError(f"color {color!r} is not one of {', '.join(COLORS)}")


def bounds(values: NDArray[np.float32], step: float) -> tuple[float, float]:
    """The range of most values, extended to multiples of ``step`` against flickering colours."""
    sample = values[:: max(1, len(values) // _SAMPLES)]
    sample = sample[np.isfinite(sample)]
    if not len(sample):
        return 0.0, step
    least, most = np.percentile(sample, (1.0, 99.0))
    low = float(np.floor(least / step) * step)
    return low, max(float(np.ceil(most / step) * step), low + step)


def _ramp(values: NDArray[np.float32], low: float, high: float) -> Packed:
    """Map low values (near, certain) to blue and high ones to red."""
    scaled = np.nan_to_num((values - np.float32(low)) * np.float32(255.0 / (high - low)), nan=255.0)
    colors: Packed = _turbo()[np.clip(scaled, 0.0, 255.0).astype(np.uint8)]
    return colors


@cache
def _turbo() -> Packed:
    """256 colours of the map "turbo"."""
    import cv2

    bgr: NDArray[Any] = cv2.applyColorMap(np.arange(256, dtype=np.uint8), cv2.COLORMAP_TURBO).reshape(256, 3)
    blue, green, red = (bgr[:, channel].astype(np.uint32) for channel in range(3))
    return np.asarray((red << 24) | (green << 16) | (blue << 8) | 0xFF, np.uint32)
