"""A ChArUco board as OpenCV describes it."""

from __future__ import annotations

import re
from typing import Any

import cv2

from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import TargetError


def dictionary(name: str) -> Any:
    """The predefined dictionary of markers ``DICT_4X4_100`` and the like.

    Raises:
        TargetError: there is none of this name; the message lists those that exist.
    """
    number = getattr(cv2.aruco, name, None) if re.fullmatch(r"DICT_[0-9A-Za-z_]+", name) else None
    if not isinstance(number, int):
        names = sorted(n for n in dir(cv2.aruco) if re.fullmatch(r"DICT_\dX\d_\d+", n))
        raise TargetError(f"ArUco dictionary {name!r:.60} does not exist; expected one of {', '.join(names)}")
    return cv2.aruco.getPredefinedDictionary(number)


def charuco(board: Board, *, legacy: bool = False) -> Any:
    """The ``cv2.aruco.CharucoBoard`` of a board of kind ``charuco``; its corner ids are the numbers of our marks.

    Args:
        board: of kind ``charuco``.
        legacy: the drawing of OpenCV before 4.6, which begins with a white square where ``rows`` is even.

    Raises:
        TargetError: the dictionary is unknown or has too few markers.
    """
    markers, needed = dictionary(board.dictionary), board.columns * board.rows // 2
    available = len(markers.bytesList)
    if needed > available:
        raise TargetError(
            f"board {board}: needs {needed} markers and {board.dictionary} has {available}; "
            "take a larger dictionary or fewer squares"
        )
    charuco_board = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_mm, board.marker_mm, markers)
    charuco_board.setLegacyPattern(legacy)
    return charuco_board
