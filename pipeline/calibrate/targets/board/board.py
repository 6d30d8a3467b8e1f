"""The kinds of flat calibration boards and the positions of their marks.

Frame of the board: origin at mark 0, x along the columns, y along the rows, z into the board, so that a board seen
from the front has about the identity as rotation. Marks are numbered by rows: mark ``row * columns + column``.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import TargetError

Array = NDArray[np.float64]
Kind = Literal["circles", "acircles", "chessboard", "charuco"]

KINDS: tuple[Kind, ...] = get_args(Kind)
DIAMETER_SHARE = 0.6
"""Diameter of a circle as a share of the pitch, where none is given."""
_MOST_MARKS = 2500
_FORMS = {
    "circles": "circles:COLSxROWS:PITCH_MM[:DIAMETER_MM]",
    "acircles": "acircles:COLSxROWS:PITCH_MM[:DIAMETER_MM]",
    "chessboard": "chessboard:INNERCOLSxINNERROWS:SQUARE_MM",
    "charuco": "charuco:COLSxROWS:SQUARE_MM:MARKER_MM:DICT",
}


@dataclass(frozen=True, slots=True)
class Board:
    """A flat target.

    Args:
        kind: ``circles`` (in rows and columns), ``acircles`` (every other row moved by half a pitch), ``chessboard``
            (its marks are the inner corners), ``charuco`` (a chessboard with ArUco markers in its white squares).
        columns, rows: of circles, of inner corners (chessboard), or of squares (charuco).
        pitch_mm: distance of neighbours in a row of circles, or side of a square. In ``acircles`` rows are half a
            pitch apart, and odd rows begin half a pitch further right (OpenCV's asymmetric grid).
        diameter_mm: of a circle; 0 = not given, then it is measured in the images.
        marker_mm, dictionary: of ``charuco``: side of a marker, name such as ``DICT_4X4_100``.
    """

    kind: Kind
    columns: int
    rows: int
    pitch_mm: float
    diameter_mm: float = 0.0
    marker_mm: float = 0.0
    dictionary: str = ""

    def __post_init__(self) -> None:
        least = 2 if self.kind in ("circles", "acircles") else 3
        if min(self.columns, self.rows) < least or self.columns * self.rows > _MOST_MARKS:
            raise TargetError(
                f"board {self.columns}x{self.rows}: expected at least {least} columns and rows and at most "
                f"{_MOST_MARKS} marks"
            )
        if not 0 < self.pitch_mm < 1e5:
            raise TargetError(f"board pitch {self.pitch_mm} mm: expected more than 0 mm and less than 100 m")
        limit = self.pitch_mm * (np.sqrt(0.5) if self.kind == "acircles" else 1.0)
        if not 0 <= self.diameter_mm < limit:
            raise TargetError(f"circle diameter {self.diameter_mm} mm: expected less than {limit:g} mm, or they touch")
        if self.kind == "charuco" and not 0 < self.marker_mm < self.pitch_mm:
            raise TargetError(f"marker {self.marker_mm} mm: expected more than 0 and less than {self.pitch_mm} mm")

    @property
    def grid(self) -> tuple[int, int]:
        """Columns and rows of marks."""
        return (self.columns - 1, self.rows - 1) if self.kind == "charuco" else (self.columns, self.rows)

    @property
    def round(self) -> bool:
        """Whether its marks are circles."""
        return self.kind in ("circles", "acircles")

    @property
    def printed_diameter_mm(self) -> float:
        """Diameter of the circles in the drawing: the given one, or the default share of the pitch."""
        return self.diameter_mm or DIAMETER_SHARE * self.pitch_mm * (0.7 if self.kind == "acircles" else 1.0)

    @property
    def points(self) -> Array:
        """Marks on the board, (n, 3) mm, z = 0."""
        columns, rows = self.grid
        row, column = (index.ravel().astype(np.float64) for index in np.mgrid[0:rows, 0:columns])
        if self.kind == "acircles":
            x, y = (column + 0.5 * (row % 2)) * self.pitch_mm, 0.5 * row * self.pitch_mm
        else:
            x, y = column * self.pitch_mm, row * self.pitch_mm
        return np.stack([x, y, np.zeros_like(x)], axis=1)

    def __str__(self) -> str:
        """The text that :func:`parse_board` reads."""
        text = f"{self.kind}:{self.columns}x{self.rows}:{self.pitch_mm:g}"
        if self.kind == "charuco":
            return f"{text}:{self.marker_mm:g}:{self.dictionary}"
        return f"{text}:{self.diameter_mm:g}" if self.diameter_mm else text


DEFAULT_BOARD = Board("circles", 11, 9, 32.0, 20.0)
"""99 circles that fit on 400 x 300 mm."""


def parse_board(text: str) -> Board:
    """The board of a text such as ``circles:11x9:32.0`` or ``charuco:12x9:30:22:DICT_4X4_100``.

    Raises:
        TargetError: the text has another form; the message names the expected one.
    """
    name, *rest = text.split(":")
    kind = next((one for one in KINDS if one == name), None)
    if kind is None:
        raise TargetError(f"board {text!r:.80}: unknown kind; expected one of {', '.join(_FORMS.values())}")
    form_error = TargetError(f"board {text!r:.80}: expected {_FORMS[kind]}")
    size = re.fullmatch(r"(\d{1,4})x(\d{1,4})", rest[0]) if rest else None
    counts = {"circles": (2, 3), "acircles": (2, 3), "chessboard": (2,), "charuco": (4,)}[kind]
    if size is None or len(rest) not in counts:
        raise form_error
    columns, rows = int(size[1]), int(size[2])
    try:
        lengths = [float(value) for value in rest[1:3]]
    except ValueError:
        raise form_error from None
    if kind == "charuco":
        return Board(kind, columns, rows, lengths[0], marker_mm=lengths[1], dictionary=rest[3])
    diameter = lengths[1] if len(lengths) > 1 else 0.0
    return Board(kind, columns, rows, lengths[0], diameter_mm=diameter)
