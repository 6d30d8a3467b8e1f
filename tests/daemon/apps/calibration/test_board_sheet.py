"""A printed board is to scale, carries its description, and is rejected if it does not fit."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.apps.calibration.board_print.board_sheet import PAPERS, board_sheet
from daemon.apps.calibration.errors import SourceError
from daemon.cli.command_table import invoke
from pipeline.calibrate.targets.board.board import parse_board
from pipeline.calibrate.targets.board.board_drawing import shapes
from tests.daemon.apps.calibration.pdf_reader import read_pdf

TEXTS = ["circles:11x9:32:20", "acircles:4x11:36:15", "chessboard:9x6:25", "charuco:11x8:24:17:DICT_4X4_100"]


@pytest.mark.parametrize("text", TEXTS)
def test_every_shape_of_the_drawing_is_on_the_page_in_its_true_size(text: str) -> None:
    board = parse_board(text)
    drawn = read_pdf(board_sheet(board).data)
    printed = shapes(board)
    bars = drawn.rectangles[: len(printed.squares)]
    if board.round:
        centres = np.array([outline[:-1].mean(axis=0) for outline in drawn.discs])
        shift = centres[0] - printed.discs[0, :2]
        assert np.abs(centres - shift - printed.discs[:, :2]).max() < 2e-5
        for outline, centre, (_, _, radius) in zip(drawn.discs, centres, printed.discs, strict=True):
            distance = np.linalg.norm(outline - centre, axis=1)
            assert np.abs(distance - radius).max() < 5e-6 * radius + 2e-5
    else:
        found = np.array(bars)
        shift = np.tile(found[0, :2] - printed.squares[0, :2], 2)
        assert np.abs(found - shift - printed.squares).max() < 2e-5


@pytest.mark.parametrize("text", TEXTS)
def test_the_margin_is_empty_and_the_ruler_is_100_mm(text: str) -> None:
    board = parse_board(text)
    drawn = read_pdf(board_sheet(board).data)
    ends = [np.reshape(drawn.rectangles, (-1, 2)) if drawn.rectangles else np.empty((0, 2)), *drawn.discs]
    corners = np.concatenate(ends)
    assert corners.min() > 4.5
    assert (corners.max(axis=0) < np.array(drawn.size_mm) - 4.5).all()
    ticks = np.array(drawn.rectangles)[-21:]
    assert (ticks[:, 0] + ticks[:, 2])[-1] / 2 - (ticks[:, 0] + ticks[:, 2])[0] / 2 == pytest.approx(100, abs=1e-4)
    # The drawing and the ruler do not touch.
    others = np.concatenate([np.reshape(drawn.rectangles[: -22 or None], (-1, 2)), *drawn.discs])
    assert others[:, 1].max() < ticks[:, 1].min()


@pytest.mark.parametrize("text", TEXTS)
def test_the_page_contains_the_board_description_as_the_parser_reads_it(text: str) -> None:
    sheet = board_sheet(parse_board(text))
    drawn = read_pdf(sheet.data)
    assert str(sheet.board) in drawn.texts
    assert parse_board(str(sheet.board)).points.tolist() == parse_board(text).points.tolist()
    assert f"({f'Calibration board {sheet.board}'})" in drawn.info
    assert b"/PrintScaling /None" in sheet.data


def test_the_default_board_fits_on_a3_and_a_paper_too_small_names_one_that_is_large_enough() -> None:
    assert board_sheet(parse_board(TEXTS[0])).paper == "a3"
    with pytest.raises(SourceError, match=r"needs 350 x 295 mm, a4 has 297 x 210 mm; --paper a3 is large enough"):
        board_sheet(parse_board(TEXTS[0]), "a4")
    with pytest.raises(SourceError, match=r"it does not fit on a0; give --paper 1\d\d\dx1\d\d\d"):
        board_sheet(parse_board("chessboard:30x30:50"))
    with pytest.raises(SourceError, match="expected one of a4, a3"):
        board_sheet(parse_board(TEXTS[0]), "letterish")
    assert board_sheet(parse_board(TEXTS[0]), "297x420").width_mm == 420
    for name, size in PAPERS.items():
        assert size[0] > size[1], name


def test_the_command_writes_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "board.pdf"
    assert invoke(["calibrate", "board", "--pdf", str(path)]) == 0
    assert read_pdf(path.read_bytes()).size_mm == pytest.approx((420, 297))
    assert "circles:11x9:32:20 on a3" in capsys.readouterr().out
