"""Symmetric renumberings are repaired where the geometry is unique; mirrored and swapped images are refused."""

from functools import cache

import numpy as np
import pytest

from pipeline.calibrate.bundle import Solution, calibrate
from pipeline.calibrate.bundle.initialise.board_symmetry import symmetries
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, Board, parse_board
from pipeline.calibrate.targets.marks import BoardView, Marks
from pipeline.common.errors import CalibrationError
from tests.pipeline.calibrate.bundle.sessions import session

SQUARE = Board("circles", 9, 9, 34.0)


@cache
def as_numbered(board: Board) -> Solution:
    views, sizes, _ = session(board, sigma=0.03)
    return calibrate(board, views, sizes)


def renumbered(view: BoardView, device: str, permutation) -> BoardView:
    old = view.marks[device]
    return BoardView(view.name, view.marks | {device: Marks(permutation[old.ids], old.pixels, old.sigma_px)})


def by_name(board: Board, name: str) -> np.ndarray:
    return next(s.permutation for s in symmetries(board) if s.name == name)


def mirrored(view: BoardView, devices, sizes, board=DEFAULT_BOARD) -> BoardView:
    """The detection in mirrored images of a grid of circles, which is numbered along the image's rows."""
    permutation = by_name(board, "mirrored left to right")
    marks = dict(view.marks)
    for device in devices:
        old = marks[device]
        pixels = old.pixels * (-1, 1) + (sizes[device][0] - 1, 0)
        marks[device] = Marks(permutation[old.ids], pixels, old.sigma_px)
    return BoardView(view.name, marks)


@pytest.mark.parametrize(
    ("text", "count"),
    [("circles:11x9:32", 4), ("circles:9x9:32", 8), ("chessboard:9x6:30", 4), ("acircles:4x11:20", 2),
     ("acircles:4x10:20", 2), ("charuco:9x6:30:22:DICT_4X4_50", 1)],
)  # fmt: skip
def test_symmetries_map_the_marks_onto_themselves(text, count):
    board = parse_board(text)
    found = symmetries(board)
    assert len(found) == count and np.array_equal(found[0].permutation, np.arange(len(board.points)))
    for s in found:
        assert sorted(s.permutation) == list(range(len(board.points)))
        assert np.abs(board.points[s.permutation] - board.points @ s.rotation.T - s.shift).max() < 1e-9
        assert np.linalg.det(s.rotation) == pytest.approx(1)


REPAIRED = [
    (DEFAULT_BOARD, "turned by 180 degrees", "left"), (SQUARE, "turned by 90 degrees", "right"),
    (DEFAULT_BOARD, "mirrored left to right", "projector"),
]  # fmt: skip
MOTIONS = [
    *(each[:2] for each in REPAIRED),
    (SQUARE, "turned by 270 degrees"),
    (DEFAULT_BOARD, "mirrored top to bottom"),
]
OTHERS = [(*motion, d) for motion in MOTIONS for d in ("left", "right", "projector") if (*motion, d) not in REPAIRED]


@pytest.mark.parametrize(
    ("board", "motion", "device"), [*REPAIRED, *(pytest.param(*case, marks=pytest.mark.long) for case in OTHERS)]
)
def test_one_view_numbered_otherwise_is_repaired(board, motion, device):
    views, sizes, _ = session(board, sigma=0.03)
    straight = as_numbered(board)
    views[5] = renumbered(views[5], device, by_name(board, motion))
    solution = calibrate(board, views, sizes)
    assert {r.view for r in solution.rejected} == {"view_05"} and all(r.repaired for r in solution.rejected)
    assert "numbering" in solution.rejected[0].reason
    assert solution.views_used == 12
    for name, value in straight.values.items():
        assert abs(solution.values[name] - value) < 1e-3 * max(straight.sigma[name], 1e-12), name


def test_several_views_numbered_otherwise_are_repaired():
    views, sizes, _ = session(sigma=0.03)
    for k in (0, 3, 4, 8):
        views[k] = renumbered(views[k], "right", by_name(DEFAULT_BOARD, "turned by 180 degrees"))
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    assert [r.view for r in solution.rejected] == ["view_00", "view_03", "view_04", "view_08"]
    assert abs(solution.baseline_mm - 500) < 0.1


@pytest.mark.parametrize("with_projector", [False, True])
def test_swapped_left_and_right_is_refused(with_projector):
    views, sizes, _ = session(sigma=0.03, devices=("left", "right", "projector")[: 2 + with_projector])
    swapped = [BoardView(v.name, v.marks | {"left": v.marks["right"], "right": v.marks["left"]}) for v in views]
    with pytest.raises(CalibrationError, match="swapped, or both cameras' images are mirrored"):
        calibrate(DEFAULT_BOARD, swapped, sizes)


def test_both_mirrored_is_refused():
    views, sizes, _ = session(sigma=0.03, devices=("left", "right"))
    with pytest.raises(CalibrationError, match="both cameras' images are mirrored"):
        calibrate(DEFAULT_BOARD, [mirrored(v, ("left", "right"), sizes) for v in views], sizes)


@pytest.mark.parametrize("device", ["left", "right"])
@pytest.mark.parametrize("board", [DEFAULT_BOARD, SQUARE])
def test_one_camera_mirrored_is_refused_by_name(device, board):
    views, sizes, _ = session(board, sigma=0.03, devices=("left", "right"))
    with pytest.raises(CalibrationError, match=f"the images of {device} are mirrored"):
        calibrate(board, [mirrored(v, (device,), sizes, board) for v in views], sizes)


def test_a_mirrored_projector_is_refused_by_name():
    views, sizes, _ = session(sigma=0.03)
    with pytest.raises(CalibrationError, match="the images of projector are mirrored"):
        calibrate(DEFAULT_BOARD, [mirrored(v, ("projector",), sizes) for v in views], sizes)


@pytest.mark.parametrize("devices", [("left",), ("left", "right")])
def test_a_board_numbered_from_behind_is_refused(devices):
    """Marks that carry their numbers, or an asymmetric grid, make a mirrored image detectable."""
    views, sizes, _ = session(sigma=0.03, devices=devices)
    behind = [
        BoardView(
            v.name,
            {d: Marks(m.ids, m.pixels * (-1, 1) + (sizes[d][0] - 1, 0), m.sigma_px) for d, m in v.marks.items()},
        )
        for v in views
    ]
    with pytest.raises(CalibrationError, match="from behind"):
        calibrate(DEFAULT_BOARD, behind, sizes)


def test_images_paired_in_another_order_are_refused():
    views, sizes, _ = session(sigma=0.03, devices=("left", "right"))
    shifted = [
        BoardView(v.name, {"left": v.marks["left"], "right": views[(k + 1) % 12].marks["right"]})
        for k, v in enumerate(views)
    ]
    with pytest.raises(CalibrationError, match="same order of the files"):
        calibrate(DEFAULT_BOARD, shifted, sizes)
