"""Numbering of lattice positions: every rotation and shift is resolved, and an ambiguous numbering is reported."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.calibrate.targets.board.board import parse_board
from pipeline.calibrate.targets.detect.grid_numbering import board_positions, clear, extent, match, oriented, symmetries

BOARDS = [
    "circles:11x9:1",
    "circles:7x7:1",
    "acircles:4x11:1",
    "acircles:5x12:1",
    "chessboard:9x6:1",
    "charuco:6x5:2:1:D",
]


@pytest.mark.parametrize(
    ("text", "ways"),
    [
        ("circles:11x9:1", 2),
        ("circles:7x7:1", 4),
        ("acircles:4x11:1", 1),
        ("acircles:4x10:1", 2),
        ("acircles:7x13:1", 1),
        ("chessboard:9x6:1", 1),
        ("chessboard:9x7:1", 2),
        ("chessboard:8x8:1", 4),
        ("chessboard:7x7:1", 2),
        ("charuco:6x5:2:1:D", 1),
    ],
)
def test_the_number_of_symmetries_of_a_board(text, ways):
    board = parse_board(text)
    found = symmetries(board)
    assert len(found) == ways
    assert found[0] == tuple(range(len(board.points)))
    apart = np.linalg.norm(board.points[:, None] - board.points, axis=2)
    for choice in found:
        turned = board.points[list(choice)]
        assert np.allclose(np.linalg.norm(turned[:, None] - turned, axis=2), apart)


@settings(deadline=None, max_examples=60)
@given(st.sampled_from(BOARDS[:4]), st.integers(0, 3), st.integers(-9, 9), st.integers(-9, 9), st.integers(0, 4))
def test_a_rotated_shifted_and_incomplete_lattice_is_numbered_as_the_board(text, turn, right, down, missing):
    board = parse_board(text)
    positions = board_positions(board) @ np.linalg.matrix_power([[0, -1], [1, 0]], turn).T + (right, down)
    kept = np.delete(np.arange(len(positions)), np.linspace(3, len(positions) - 6, missing).astype(int))
    found = match(positions[kept], board)
    assert found.hits == len(kept) and found.runner_up_hits < found.hits
    assert any((np.array(choice)[found.ids] == kept).all() for choice in symmetries(board))


def test_a_missing_row_makes_the_numbering_unclear():
    board = parse_board("circles:11x9:1")
    positions = board_positions(board)
    assert clear(match(positions, board), board)
    assert not clear(match(positions[positions[:, 1] > 0], board), board)
    assert extent(positions[positions[:, 1] > 0], board) == (11, 8)


def test_the_numbering_is_the_same_wherever_it_began():
    for text in BOARDS:
        board = parse_board(text)
        pixels = board.points[:, :2] @ np.array([[0.9, 0.3], [-0.2, 0.8]]) * 30 + 200
        ids = [oriented(np.array(choice), pixels[list(choice)], board) for choice in symmetries(board)]
        for choice, numbered in zip(symmetries(board), ids, strict=True):
            assert (board.points[numbered] == board.points[list(choice)]).all()
