"""The errors of the detectors: why an image shows no board that can be used, and what to change."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.localise.gray_image import GrayImage
from pipeline.common.errors import TargetError

_STRONG_EDGES = 0.003
BLURRED_PX = 4.0
"""Sigma of the edges from which on an image without marks is called blurred."""
_SATURATED = 0.1


def edge_sigma_px(image: GrayImage) -> float:
    """Sigma of the strongest edges in an image, of any object: step height over greatest slope."""
    values = image.values
    scale = max(1, int(np.sqrt(values.size / 1.5e6)))
    small = cv2.resize(values, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA) if scale > 1 else values
    smooth = cv2.GaussianBlur(small, (0, 0), 1.0)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8))
    kernel = np.ones((31, 31), np.uint8)
    height = cv2.dilate(smooth, kernel) - cv2.erode(smooth, kernel)
    strong = slope >= np.quantile(slope, 1 - _STRONG_EDGES)
    ratio = np.median(height[strong] / np.maximum(slope[strong], 1e-12)) / np.sqrt(2 * np.pi)
    return float(scale * np.sqrt(max(ratio**2 - 1.0, 0.0)))


def nothing(board: Board, image: GrayImage) -> TargetError:
    """The error for an image without any part of the board: saturated, out of focus, or empty."""
    if image.saturated > _SATURATED:
        return TargetError(
            f"no marks found: {image.saturated:.0%} of the image is saturated (limit {_SATURATED:.0%}), which "
            "hides the marks; lower the exposure or the light"
        )
    sigma = edge_sigma_px(image)
    if sigma > BLURRED_PX:
        return too_blurred(sigma, BLURRED_PX)
    small = "; a marker is read from about 4 pixels a cell on" if board.kind == "charuco" else ""
    return TargetError(
        f"no marks found: the board {board} is not in the image; bring the whole board into the image, "
        f"with even light and without fringes on it{small}"
    )


def too_blurred(sigma: float, limit: float) -> TargetError:
    """The error for an image with defocus or motion blur."""
    return TargetError(
        f"image too blurred: its edges have a sigma of {sigma:.1f} px (limit {limit:.1f} px); focus, or hold the "
        "board still, or expose shorter"
    )


def too_few(board: Board, count: int, image: GrayImage) -> TargetError:
    """The error for a board of which only some marks are detected."""
    total = len(board.points)
    hint = ""
    if image.saturated > _SATURATED:
        hint = f"; {image.saturated:.0%} of the image is saturated, lower the exposure"
    return TargetError(
        f"only {count} of the {total} marks of board {board} found; bring the whole board into the image, nothing in "
        f"front of it, no glare and no sharp shadow on it{hint}"
    )


def wrong_size(board: Board, columns: int, rows: int) -> TargetError:
    """The error for a board of another size than the given one."""
    expected = "x".join(str(count) for count in board.grid)
    return TargetError(
        f"wrong board: the image shows a grid of {columns}x{rows} marks, but {expected} is expected ({board}); "
        "give the board that is used, or show all of its marks"
    )


def runs_out(image: GrayImage, pixels: NDArray[np.float64], pitch_px: float) -> bool:
    """Whether a grid ends within about a pitch of the image's edge, so that it may continue outside."""
    height, width = image.values.shape
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return bool((low < 1.1 * pitch_px).any() or (high > np.array([width, height]) - 1 - 1.1 * pitch_px).any())


def two_boards(board: Board) -> TargetError:
    """The error for more than one board."""
    return TargetError(f"the image shows two boards {board} or more; leave one of them in it")


def mirrored(board: Board) -> TargetError:
    """The error for an image that was flipped."""
    return TargetError(
        f"the board {board} is mirrored in the image; switch off the flip of the camera or of the file's reader, "
        "and take the image directly, not in a mirror"
    )
