"""Detection of the marks of a given board in an image, by the detector of its kind."""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.detect.charuco import find_charuco
from pipeline.calibrate.targets.detect.chessboard import find_chessboard
from pipeline.calibrate.targets.detect.circle_grid import find_circles
from pipeline.calibrate.targets.detect.detection import Detection
from pipeline.calibrate.targets.localise.gray_image import to_gray

__all__ = ["Detection", "find_marks"]


def find_marks(image: NDArray[Any], board: Board, *, refine: bool = True, channel: int | None = None) -> Detection:
    """Detect the marks of a board.

    Args:
        image: (H, W) or (H, W, 3), uint8, uint16 or float32; fringe light off.
        board: what is printed on the board; dark on light or light on dark.
        refine: fit every mark for its best position and its standard deviation; False is faster and good to some
            tenths of a pixel, for live tracking; it neither rejects blur (see ``sharpness_px``) nor searches for a
            second chessboard.
        channel: use this colour alone, 0 to 2 (for lateral chromatic aberration); None = the mean of the colours that
            are not clipped.

    Returns:
        Marks numbered as the board numbers them, sorted by number. Some marks may be missing where the others
        determine the numbering. Boards that are symmetric under a rotation are numbered by the rule of
        :mod:`pipeline.calibrate.targets.detect.grid_numbering`.

    Raises:
        TargetError: nothing of the board, only some marks, another size, two boards, too blurred, saturated, mirrored;
            the message names the cause and the remedy.
    """
    gray = to_gray(image, channel=channel)
    if board.round:
        return find_circles(gray, board, refine=refine)
    if board.kind == "chessboard":
        return find_chessboard(gray, board, refine=refine)
    return find_charuco(gray, board, refine=refine)
