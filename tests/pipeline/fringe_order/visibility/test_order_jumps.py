"""Order jumps: found where a surface continues with another order, and not at depth edges or edges of texture."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.decode.pixel_descriptor import VALID
from pipeline.fringe_order.left_right_check import UNDECIDED
from pipeline.fringe_order.visibility.order_jumps import SMALLEST, Jumps, Segments

TOP, DOWN, LEFT, STEP = 1, 3, 2, 3
SHAPE = 24, 30
SLOPES = 0.45, 0.03
PART = np.s_[8:20, 9:24]
"""Lattice pixels of a second segment: 12 rows, 15 columns."""


def surface(slope_x: float = SLOPES[0], slope_y: float = SLOPES[1]) -> NDArray[np.float64]:
    """Absolute phase (H, W) of a plane, radians."""
    y, x = np.mgrid[: TOP + DOWN * SHAPE[0], : LEFT + STEP * SHAPE[1]]
    return 40 + slope_x * x + slope_y * y


def found(absolute: Any, order_change: Any = 0, mean: Any = 90, undecided: Any = False) -> tuple[Jumps, Segments]:
    """Jumps of an image with this absolute phase (H, W), its orders changed (h, w) and means (h, w)."""
    segments = Segments(SHAPE)
    lattice = np.s_[TOP::DOWN, LEFT::STEP]
    order = np.floor(absolute / (2 * np.pi))
    phase = (absolute - 2 * np.pi * order).astype(np.float32)
    orders = (order[lattice][: SHAPE[0], : SHAPE[1]] + order_change).astype(np.int16)
    orders[np.broadcast_to(undecided, SHAPE)] = UNDECIDED
    descriptors = np.zeros(phase.shape, np.int32)
    descriptors[lattice] = VALID | np.broadcast_to(mean, SHAPE).astype(np.int32)
    return segments.find(orders, TOP, DOWN, LEFT, STEP, phase, descriptors, SLOPES), segments


def changed(change: float) -> NDArray[np.float64]:
    out = np.zeros(SHAPE)
    out[PART] = change
    return out


def pixels(lattice: NDArray[np.float64]) -> NDArray[np.float64]:
    """Values (H, W) of the lattice pixels' surroundings."""
    wide = np.kron(lattice, np.ones((DOWN, STEP)))
    return np.pad(wide, ((TOP, 0), (LEFT, 0)), mode="edge")


@settings(max_examples=30, deadline=None)
@given(st.integers(-9, 9), st.floats(-0.2, 0.2), st.floats(-0.2, 0.2))
def test_a_wrong_order_of_a_part_is_one_jump_all_around_it(change: int, more_x: float, more_y: float) -> None:
    jumps, segments = found(surface(SLOPES[0] + more_x, SLOPES[1] + more_y), changed(change))
    if change == 0:
        assert len(segments.sizes) == 1
        assert len(jumps.change) == 0
        return
    assert segments.sizes.tolist() == [24 * 30 - 12 * 15, 12 * 15]
    assert (segments.label == 1 + (changed(1) > 0)).all()
    assert (jumps.first.tolist(), jumps.second.tolist(), jumps.change.tolist()) == ([0], [1], [change])
    # Places beside its rows' and columns' ends; the windows of corners contain both.
    assert jumps.places[0] == jumps.continuing[0] == 2 * (12 + 15)


@settings(max_examples=30, deadline=None)
@given(st.integers(-4, 4), st.floats(0.8, 2 * np.pi - 0.8))
def test_a_depth_edge_that_is_no_whole_number_of_turns_is_none(turns: int, rest: float) -> None:
    jumps, segments = found(surface() + pixels(changed(2 * np.pi * turns + rest)))
    assert len(jumps.change) == 0
    assert len(segments.sizes) == (1 if abs(2 * np.pi * turns + rest) < 1.2 else 2)


def test_another_texture_is_no_continuation() -> None:
    jumps, segments = found(surface(), changed(3), 90 + changed(40))
    assert len(segments.sizes) == 2
    assert len(jumps.change) == 0
    # As many counts less as dark surfaces have noise are none.
    assert found(surface(), changed(3), 90 + changed(5))[0].continuing.tolist() == [54]


def test_a_part_that_is_divided_has_the_jumps_of_its_own_border() -> None:
    undecided = np.zeros(SHAPE, np.bool_)
    undecided[:, 14:17] = True
    undecided[9, 14:17] = False
    # Below, the orders of both halves are wrong, by one and by three.
    change = np.where(np.arange(SHAPE[0])[:, None] >= 18, np.where(np.arange(SHAPE[1]) >= 15, 3, 1), 0)
    jumps, segments = found(surface(), change, undecided=undecided)
    assert (sorted(jumps.change), len(set(jumps.first))) == ([1, 3], 1)
    divided = segments.divide()
    assert (sorted(divided.change), len(set(divided.first))) == ([1, 3], 2)
    assert sorted(divided.places) == sorted(jumps.places)


def test_borders_that_continue_in_part_count_in_part() -> None:
    rest = changed(1.0)
    rest[14:] = 0.0
    jumps, _ = found(surface() + pixels(rest), changed(3))
    assert jumps.places[0] == 54
    assert 15 + 12 <= jumps.continuing[0] < 15 + 2 * 12


@pytest.mark.parametrize("gap", [0, 1, 2])
def test_undecided_pixels_between_segments_do_not_separate_them(gap: int) -> None:
    undecided = np.zeros(SHAPE, np.bool_)
    undecided[:, 15 : 15 + gap] = True
    change = np.where(np.arange(30) >= 15, 2, 0)
    jumps, _ = found(surface(), change, undecided=undecided)
    assert jumps.change.tolist() == [2]
    assert jumps.continuing[0] == jumps.places[0] >= SHAPE[0]
    undecided[:, 15:19] = True
    assert len(found(surface(), change, undecided=undecided)[0].change) == 0


@pytest.mark.parametrize("width", [1, 2])
@pytest.mark.parametrize("row", [0, 9, SHAPE[0] - 2])
def test_what_hangs_together_by_one_lattice_pixel_is_divided(width: int, row: int) -> None:
    undecided = np.zeros(SHAPE, np.bool_)
    undecided[:, 14:17] = True
    undecided[row + 2 - width : row + 2, 14:17] = False
    _, segments = found(surface(), undecided=undecided)
    assert len(segments.sizes) == 1
    segments.divide()
    # The end of the image may be that of a wider connection.
    assert len(segments.sizes) == (2 if width == 1 and row + 1 < SHAPE[0] - 1 else 1)


def test_segments_of_few_pixels_have_no_jumps() -> None:
    few = np.zeros(SHAPE)
    few[5:8, 5:7] = 4
    assert few.sum() / 4 < SMALLEST
    jumps, segments = found(surface(), few)
    assert len(segments.sizes) == 1
    assert len(jumps.change) == 0


def test_rows_and_columns_are_treated_alike() -> None:
    orders = changed(-2)
    orders[4:12, 3:20] += 5
    along, _ = found(surface(0.45, 0.03), orders)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    assert len(along.change) >= 2
    flat = Segments(SHAPE[::-1])
    absolute = (40 + 0.45 * (LEFT + STEP * x) + 0.03 * (TOP + DOWN * y)).T
    order = np.floor(absolute / (2 * np.pi))
    phase = (absolute - 2 * np.pi * order).astype(np.float32)
    across = flat.find(
        (order + orders.T).astype(np.int16), 0, 1, 0, 1, phase, np.full(phase.shape, VALID | 90, np.int32),
        (0.03 * DOWN, 0.45 * STEP),
    )  # fmt: skip
    assert sorted(zip(along.continuing, along.places, abs(along.change), strict=True)) == sorted(
        zip(across.continuing, across.places, abs(across.change), strict=True)
    )
