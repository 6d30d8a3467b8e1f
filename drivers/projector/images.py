"""Test images of a projector: plain ones, a cross, and one in which every lost or scaled pixel is visible."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

BORDER = 16
"""Width of the checkered border, pixels."""
COLORS = ((255, 0, 0), (0, 255, 0), (0, 0, 255), (255, 255, 255), (0, 0, 0), (128, 128, 128))


def plain(size: tuple[int, int], level: int) -> NDArray[np.uint8]:
    """Return an image of one grey level, 0 to 255: (H, W, 3)."""
    width, height = size
    return np.full((height, width, 3), level, np.uint8)


def cross(size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return a white frame and white lines through the middle, one pixel wide (two where the side is even)."""
    image = plain(size, 0)
    image[[0, -1]] = image[:, [0, -1]] = 255
    _cross_hairs(image)
    return image


def alignment(size: tuple[int, int]) -> NDArray[np.uint8]:
    """Return the alignment image: (H, W, 3).

    From outside in: a white frame of one pixel (a side that is cut off is overscan); a border of a 1-pixel checkerboard
    (even grey from afar; moiré or blotches mean scaling or sharpening); a grey ramp across and one down; blocks of red,
    green, blue, white, black and grey; blocks of 1-pixel lines across and down; the cross hairs.
    """
    width, height = size
    image = plain(size, 64)
    rows, columns = np.indices((height, width))
    checkered = ((rows + columns) % 2 * 255).astype(np.uint8)
    border = np.minimum.reduce([rows, columns, height - 1 - rows, width - 1 - columns]) < BORDER
    image[border] = checkered[border][:, None]
    _ramps(image)
    _blocks(image, checkered)
    _cross_hairs(image)
    image[[0, -1]] = image[:, [0, -1]] = 255
    return image


def _ramps(image: NDArray[np.uint8]) -> None:
    """Draw ramps from 0 to 255 along the top and the left, inside the border."""
    height, width = image.shape[:2]
    inside, thick = slice(BORDER, -BORDER), slice(BORDER, 2 * BORDER)
    image[thick, inside] = np.linspace(0, 255, width - 2 * BORDER).round().astype(np.uint8)[None, :, None]
    image[inside, thick] = np.linspace(0, 255, height - 2 * BORDER).round().astype(np.uint8)[:, None, None]


def _blocks(image: NDArray[np.uint8], checkered: NDArray[np.uint8]) -> None:
    """Draw colours in a row above the middle, line patterns in a row below it."""
    height, width = image.shape[:2]
    side = max(1, min(width // (2 * len(COLORS)), height // 8))
    rows, columns = np.indices((height, width))
    lines = (checkered, (columns % 2 * 255).astype(np.uint8), (rows % 2 * 255).astype(np.uint8))
    for number, color in enumerate(COLORS):
        left = width * (2 * number + 1) // (2 * len(COLORS)) - side // 2
        above = slice(height // 3 - side // 2, height // 3 - side // 2 + side)
        below = slice(2 * height // 3 - side // 2, 2 * height // 3 - side // 2 + side)
        across = slice(left, left + side)
        image[above, across] = color
        image[below, across] = lines[number % len(lines)][below, across][..., None]


def _cross_hairs(image: NDArray[np.uint8]) -> None:
    height, width = image.shape[:2]
    image[(height - 1) // 2 : height // 2 + 1] = 255
    image[:, (width - 1) // 2 : width // 2 + 1] = 255
