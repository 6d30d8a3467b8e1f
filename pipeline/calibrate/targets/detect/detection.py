"""What a finder answers, and what it says when it cannot."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.localise.gray_image import GreyPicture
from pipeline.calibrate.targets.marks import Marks
from pipeline.common.errors import TargetError

_STRONG_EDGES = 0.003
BLURRED_PX = 4.0
"""Sigma of the edges from which on a picture without marks is called blurred."""
_SATURATED = 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """The marks of one board in one picture.

    Args:
        marks: see :class:`pipeline.calibrate.targets.marks.Marks`.
        sharpness_px: sigma of the Gaussian that blurs the marks' edges, pixels; the pixels' own aperture is part of it,
            so that about 0.5 is the sharpest there is.
        contrast: light minus dark over light, 0 to 1, median of the marks.
        saturated: share of the picture's samples that are clipped, all colours counted.
    """

    marks: Marks
    sharpness_px: float
    contrast: float
    saturated: float


def edge_sigma_px(picture: GreyPicture) -> float:
    """Sigma of the strongest edges in a picture, whatever they belong to: step height over greatest slope."""
    values = picture.values
    scale = max(1, int(np.sqrt(values.size / 1.5e6)))
    small = cv2.resize(values, None, fx=1 / scale, fy=1 / scale, interpolation=cv2.INTER_AREA) if scale > 1 else values
    smooth = cv2.GaussianBlur(small, (0, 0), 1.0)
    slope = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8))
    kernel = np.ones((31, 31), np.uint8)
    height = cv2.dilate(smooth, kernel) - cv2.erode(smooth, kernel)
    strong = slope >= np.quantile(slope, 1 - _STRONG_EDGES)
    ratio = np.median(height[strong] / np.maximum(slope[strong], 1e-12)) / np.sqrt(2 * np.pi)
    return float(scale * np.sqrt(max(ratio**2 - 1.0, 0.0)))


def nothing(board: Board, picture: GreyPicture) -> TargetError:
    """The error for a picture without any part of the board: saturated, out of focus, or empty."""
    if picture.saturated > _SATURATED:
        return TargetError(
            f"no marks found: {picture.saturated:.0%} of the picture is saturated (limit {_SATURATED:.0%}), the marks "
            "are lost in it; lower the exposure or the light"
        )
    sigma = edge_sigma_px(picture)
    if sigma > BLURRED_PX:
        return too_blurred(sigma, BLURRED_PX)
    small = "; a marker is read from about 4 pixels a cell on" if board.kind == "charuco" else ""
    return TargetError(
        f"no marks found: the picture shows nothing of the board {board}; bring the whole board into the picture, "
        f"with even light and without fringes on it{small}"
    )


def too_blurred(sigma: float, limit: float) -> TargetError:
    """The error for a picture that is out of focus or moved."""
    return TargetError(
        f"picture too blurred: its edges have a sigma of {sigma:.1f} px (limit {limit:.1f} px); focus, or hold the "
        "board still, or expose shorter"
    )


def too_few(board: Board, count: int, picture: GreyPicture) -> TargetError:
    """The error for a board of which only some marks can be seen."""
    whole = len(board.points)
    lost = ""
    if picture.saturated > _SATURATED:
        lost = f"; {picture.saturated:.0%} of the picture is saturated, lower the exposure"
    return TargetError(
        f"only {count} of the {whole} marks of board {board} found; bring the whole board into the picture, nothing in "
        f"front of it, no glare and no sharp shadow on it{lost}"
    )


def wrong_size(board: Board, columns: int, rows: int) -> TargetError:
    """The error for a board of another size than was told."""
    wanted = "x".join(str(count) for count in board.grid)
    return TargetError(
        f"wrong board: the picture shows a grid of {columns}x{rows} marks and {wanted} was told ({board}); "
        "tell the board that is used, or show all of its marks"
    )


def runs_out(picture: GreyPicture, pixels: NDArray[np.float64], pitch_px: float) -> bool:
    """Whether a grid ends less than about a pitch before the edge of the picture, so that it may go on outside."""
    height, width = picture.values.shape
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return bool((low < 1.1 * pitch_px).any() or (high > np.array([width, height]) - 1 - 1.1 * pitch_px).any())


def two_boards(board: Board) -> TargetError:
    """The error for more than one board."""
    return TargetError(f"the picture shows two boards {board} or more; leave one of them in it")


def mirrored(board: Board) -> TargetError:
    """The error for a picture that was flipped."""
    return TargetError(
        f"the board {board} is mirrored in the picture; switch the flip of the camera or of the file's reader off, "
        "and look at the board directly"
    )
