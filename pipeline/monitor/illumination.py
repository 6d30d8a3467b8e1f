"""Illumination of an image: saturated samples and fringe amplitude of each colour, from a few lines of pixels.

Two samples of a fringe of amplitude B and period P that lie s apart differ by ``2 B sin(pi s / P) sin(...)``; with a
uniformly distributed phase, the median of the square of the difference is ``2 (B sin(pi s / P))^2``. Half a period
apart the surface's own colour hardly differs, so that it does not count as fringe.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.decode.raw_image import BAYER

Plane = NDArray[np.float32]

LINES = 8
_WHITE = 254.0
_LEAST = 5.0  # counts of modulation from which there is light
_ENOUGH = 64  # samples needed for an amplitude


@dataclass(frozen=True, slots=True)
class ImageIllumination:
    """Illumination of one image by channel: red, green, blue, or the only one of a monochrome image.

    Args:
        saturated: fraction of saturated samples; amplitude: of the fringes, counts, NaN where there is no light.
    """

    saturated: tuple[float, ...]
    amplitude: tuple[float, ...]


def measure_illumination(
    image: NDArray[Any],
    encoding: str,
    modulation: NDArray[np.uint8],
    *,
    period_px: float,
    stride: int = 1,
    axis: str = "x",
) -> ImageIllumination:
    """Measure some lines of a raw image.

    Args:
        image: (H, W) or (H, W, 3), uint8, or uint16 of full scale 65535; modulation: of every ``stride``-th pixel.
        period_px: of the fringes; axis: along which the phase grows.
    """
    if axis == "y":
        image, modulation = image.swapaxes(0, 1), modulation.swapaxes(0, 1)
    parts = [_channel(*plane, period_px) for plane in _planes(image, encoding, modulation, stride, axis)]
    return ImageIllumination(tuple(p[0] for p in parts), tuple(p[1] for p in parts))


def _planes(
    image: NDArray[Any], encoding: str, modulation: NDArray[np.uint8], stride: int, axis: str
) -> list[tuple[Plane, NDArray[np.bool_], int]]:
    """For each channel its samples on the chosen lines, their lit ones, and their spacing in pixels."""
    mosaic = BAYER.get(encoding)
    rows = np.linspace(0, image.shape[0] - 2, min(LINES, image.shape[0] // 2) + 2)[1:-1].astype(int) // 2 * 2
    lit = modulation[np.minimum(rows // stride, modulation.shape[0] - 1)] >= _LEAST
    lit = lit.repeat(stride, axis=1) if stride > 1 else lit
    scale = np.float32(255 / 65535) if image.dtype == np.uint16 else np.float32(1)
    if mosaic is None:
        lines = image[rows].astype(np.float32) * scale
        planes = [lines] if lines.ndim == 2 else [lines[..., c] for c in range(lines.shape[2])]
        return [(plane, lit, 1) for plane in planes]
    out = []
    for channel in range(3):
        down, across = _place(mosaic, channel, axis)
        out.append((image[rows + down][:, across::2].astype(np.float32), lit[:, across::2], 2))
    return out


def _place(mosaic: tuple[tuple[int, int], tuple[int, int]], channel: int, axis: str) -> tuple[int, int]:
    """Line and position of the first pixel of a channel in the mosaic."""
    down, across = next((r, c) for r in (0, 1) for c in (0, 1) if mosaic[r][c] == channel)
    return (down, across) if axis == "x" else (across, down)


def _channel(plane: Plane, lit: NDArray[np.bool_], step: int, period_px: float) -> tuple[float, float]:
    saturated = float(np.count_nonzero(plane >= _WHITE)) / max(1, plane.size)
    apart = max(1, round(period_px / 2 / step))
    width = min(plane.shape[1], lit.shape[1]) - apart
    gain = 2 * np.sin(np.pi * min(0.5, apart * step / period_px))
    if width < 1:
        return saturated, float("nan")
    both = lit[:, :width] & lit[:, apart : apart + width]
    squares = np.square(plane[:, apart : apart + width] - plane[:, :width])[both]
    if len(squares) < _ENOUGH:
        return saturated, float("nan")
    middle = float(np.partition(squares, len(squares) // 2)[len(squares) // 2])
    return saturated, float(np.sqrt(2 * middle) / gain)
