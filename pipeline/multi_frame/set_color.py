"""Colour of a set of grey images: the mean over the steps of a fringe has no fringe, and is as sharp as the images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.decode.kernels.color_texture import rough_colors
from pipeline.decode.kernels.mosaic_fit import EIGHTHS
from pipeline.decode.raw_image import BAYER, read_only
from pipeline.rig.calibration import ColorModel


def set_color(steps: Sequence[NDArray[Any]], color: ColorModel, encoding: str) -> NDArray[np.uint8]:
    """The colour of every pixel, (H, W, 3) uint8, linear, a white surface has equal channels; grey without colours.

    Args:
        steps: images of one fringe in equal steps; color: of their camera; encoding: of the images.
    """
    scale = np.float32(len(steps) * (257 if encoding == "mono16" else 1))
    mean: NDArray[Any] = np.asarray(np.sum(np.stack(steps), axis=0, dtype=np.float32)) / scale
    if encoding.startswith("mono"):
        gray = mean - np.float32(color.black.mean())
        return _counts(np.repeat(gray[..., None], 3, axis=2))
    if encoding in BAYER:
        height, width = mean.shape
        colors = np.empty((height, 3 * width), np.uint16)
        rough_colors(height, read_only(_counts(mean)), np.array(BAYER[encoding], dtype=np.int64), colors)
        mean = colors.reshape(height, width, 3) / np.float32(EIGHTHS)
    return _counts((mean - color.black.astype(np.float32)) @ color.unmix.T.astype(np.float32))


def _counts(values: NDArray[Any]) -> NDArray[np.uint8]:
    return np.asarray(np.rint(values).clip(0, 255), dtype=np.uint8)
