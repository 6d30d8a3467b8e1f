"""A calibration board as a page to print: the drawing in the middle, below it its description and a ruler."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from daemon.apps.calibration.board_print.pdf_page import Page
from daemon.apps.calibration.errors import SourceError
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.board.board_drawing import shapes

PAPERS = {"a4": (297.0, 210.0), "a3": (420.0, 297.0), "a2": (594.0, 420.0), "a1": (841.0, 594.0), "a0": (1189.0, 841.0)}
EDGE_MM = 5.0
"""White margin that printers need."""
STRIP_MM = 9.0
"""Height of the line with the description and the ruler."""
RULER_MM = 100
_TEXT_MM = 2.6


@dataclass(frozen=True, slots=True)
class Sheet:
    """A page with a board.

    Args:
        board: with the drawn diameter.
        data: the PDF.
        paper: name or size; width_mm, height_mm: its dimensions.
    """

    board: Board
    data: bytes
    paper: str
    width_mm: float
    height_mm: float


def board_sheet(board: Board, paper: str = "") -> Sheet:
    """Draw the PDF page of a board.

    Args:
        paper: ``a4`` to ``a0``, ``420x297`` in mm, or empty for the smallest named one that fits.

    Raises:
        SourceError: the paper is too small (the message names one that fits), or its name is unknown.
        TargetError: the board cannot be drawn.
    """
    if board.round:  # the description states the drawn diameter
        board = replace(board, diameter_mm=board.printed_diameter_mm)
    printed = shapes(board)
    boxes = [printed.discs[:, :2] - printed.discs[:, 2:], printed.squares[:, :2]]
    low = np.concatenate(boxes).min(axis=0)
    high = np.concatenate([printed.discs[:, :2] + printed.discs[:, 2:], printed.squares[:, 2:]]).max(axis=0)
    drawing = float(high[0] - low[0]), float(high[1] - low[1])
    name, size = _paper(board, paper, drawing)
    page = Page(*size, title=f"Calibration board {board}", subject=f"fringed board {board}; print at 100 %")
    x, y = (size[0] - drawing[0]) / 2 - low[0], (size[1] - STRIP_MM - drawing[1]) / 2 - low[1]
    for u, v, radius in printed.discs:
        page.disc(float(x + u), float(y + v), float(radius))
    if len(printed.squares):
        page.rectangles([(x + a, y + b, x + c, y + d) for a, b, c, d in printed.squares.tolist()])
    _legend(page, board)
    return Sheet(board, page.data(), name, *size)


def needed_mm(drawing: tuple[float, float]) -> tuple[float, float]:
    """Width and height of the smallest paper for a drawing."""
    legend = RULER_MM + 2 * EDGE_MM
    return max(drawing[0] + 2 * EDGE_MM, legend), drawing[1] + 2 * EDGE_MM + STRIP_MM


def _paper(board: Board, paper: str, drawing: tuple[float, float]) -> tuple[str, tuple[float, float]]:
    need = needed_mm(drawing)
    portrait = needed_mm((drawing[1], drawing[0]))
    fits = [name for name, size in PAPERS.items() if _turned(size, need) is not None]
    if not paper:
        if not fits:
            raise SourceError(f"board {board}: it does not fit on a0; give --paper {_least(need)}")
        paper = fits[0]
    size = _size(paper)
    turned = _turned(size, need)
    if turned is None:
        least = need if need[0] <= portrait[0] else portrait
        other = f"--paper {fits[0]} is large enough" if fits else f"give --paper {_least(least)}"
        raise SourceError(
            f"board {board}: with margin and ruler it needs {need[0]:g} x {need[1]:g} mm, {paper} has "
            f"{size[0]:g} x {size[1]:g} mm; {other}"
        )
    return paper, turned


def _size(paper: str) -> tuple[float, float]:
    if paper.lower() in PAPERS:
        return PAPERS[paper.lower()]
    custom = re.fullmatch(r"(\d{1,4}(?:\.\d+)?)x(\d{1,4}(?:\.\d+)?)", paper)
    if custom is None or not all(50 <= float(side) <= 5000 for side in custom.groups()):
        raise SourceError(
            f"paper {paper!r:.40}: expected one of {', '.join(PAPERS)}, or width x height in mm such as 420x297 "
            "(50 to 5000 mm)"
        )
    return float(custom[1]), float(custom[2])


def _turned(size: tuple[float, float], need: tuple[float, float]) -> tuple[float, float] | None:
    """The size in landscape or portrait, whichever fits; None if neither does."""
    orientations = (size, (size[1], size[0]))
    return next((s for s in orientations if s[0] >= need[0] and s[1] >= need[1]), None)


def _least(need: tuple[float, float]) -> str:
    return f"{int(np.ceil(need[0]))}x{int(np.ceil(need[1]))}"


def _legend(page: Page, board: Board) -> None:
    """Description on the left, ruler on the right; on narrow paper the description is above the ruler."""
    right, foot = page.width_mm - EDGE_MM, page.height_mm - EDGE_MM
    start = right - RULER_MM
    ticks = [(start, foot - 3.2, right, foot - 3.0)]
    for mm in range(0, RULER_MM + 1, 5):
        length = 2.4 if mm % 10 == 0 else 1.2
        # The middle of the first and the last tick are the ends of the 100 mm.
        ticks.append((start + mm - 0.1, foot - 3.2 - length, start + mm + 0.1, foot - 3.0))
    page.rectangles(ticks)
    page.text(start, foot, _TEXT_MM, f"must measure {RULER_MM} mm")
    page.text(EDGE_MM, foot - 3.2 if start - EDGE_MM > 60 else foot - 6.4, _TEXT_MM, str(board))
    if start - EDGE_MM > 60:
        page.text(EDGE_MM, foot, _TEXT_MM, "fringed: print at 100 %, glue on a flat plate")
