"""Visibility: a segment with an order jump is rejected where the other camera cannot see it with the right order."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.fringe_order.order_lattice import towards_nearer
from pipeline.fringe_order.order_search import OrderSearch
from pipeline.fringe_order.semi_global_aggregation import NONE
from pipeline.fringe_order.visibility.order_jumps import Jumps
from pipeline.fringe_order.visibility.uniqueness import Claims
from pipeline.fringe_order.visibility.visibility_test import may_have_parts, nearest_claims, unseen_segments
from tests.pipeline.small import images, pair, reconstructor

SHAPE = 20, 60
WALL, STRIP, OTHER = 1, 2, 3
"""Labels: columns 0 to 29, 30 to 39 and 40 to 59."""
LABEL = np.broadcast_to(np.repeat([WALL, STRIP, OTHER], [30, 10, 20]), SHAPE).astype(np.uint16)
SIZES = np.array([600, 200, 400], np.int32)
WRONG = 4
"""Orders that the strip's phase is ahead of the wall's."""


def jumps(continuing: int = 20, places: int = 20) -> Jumps:
    """One jump, from the wall to the strip."""
    return Jumps(*(np.array([x]) for x in (WALL - 1, STRIP - 1, WRONG, continuing, places)))


def judged(
    shift: int,
    cost: float,
    jump: Jumps | None = None,
    *,
    kept: NDArray[np.int16] | None = None,
    nearer: int = 1,
    sizes: NDArray[np.int32] = SIZES,
) -> list[int]:
    """Labels that are rejected.

    Args:
        shift: columns from the strip's claims to those of its continued order; cost: of the latter, -1 = no place.
        kept: orders after the left-right check, all by default.
    """
    order = np.where(LABEL == STRIP, 10 + WRONG, 10).astype(np.int16)
    columns = np.arange(LABEL.size, dtype=np.int32).reshape(SHAPE)

    def claims_of(orders: NDArray[np.int16]) -> Claims:
        if orders.size == 0:
            return Claims(*(np.empty((0, 0), kind) for kind in (np.int32, np.float32, np.float32)))
        continued = (orders == 10) & (LABEL == STRIP)
        place = np.where(continued, columns + shift if cost >= 0 else -1, columns)
        place[orders == NONE] = -1
        return Claims(
            place.astype(np.int32), np.zeros(SHAPE, np.float32), np.where(continued, cost, 0.1).astype(np.float32)
        )

    owner = np.full(LABEL.size, -1, np.int32)
    nearest_claims(columns, 0, nearer, owner)
    rejected = unseen_segments(
        LABEL, sizes, jumps() if jump is None else jump, order, order if kept is None else kept, owner, claims_of, 0,
        nearer, 13,
    )  # fmt: skip
    return [int(k) + 1 for k in np.flatnonzero(rejected)]


def test_a_strip_whose_continued_order_lies_outside_the_other_image_is_rejected() -> None:
    assert judged(0, -1.0) == [STRIP]


def test_a_strip_that_its_continued_order_explains_as_well_is_rejected() -> None:
    assert judged(0, 0.14) == [STRIP]
    assert judged(0, 0.3) == []


def test_a_strip_behind_a_nearer_surface_is_rejected_and_before_a_farther_one_is_not() -> None:
    # The claims of the columns to the right of the strip's: nearer ones, or farther ones.
    assert judged(12, 1.2) == [STRIP]
    assert judged(12, 1.2, nearer=-1) == []
    assert judged(-12, 1.2) == []
    assert judged(-12, 1.2, nearer=-1) == [STRIP]


def test_a_surface_is_not_hidden_by_itself() -> None:
    assert judged(3, 1.2) == []


def test_few_places_that_continue_show_nothing() -> None:
    assert judged(0, -1.0, jumps(7, 7)) == []
    assert judged(0, -1.0, jumps(20, 40)) == []
    # The square root of its size: half of it for the smaller segment.
    assert judged(0, -1.0, jumps(8, 8)) == [STRIP]


def test_a_strip_that_the_left_right_check_rejected_already_is_left_alone() -> None:
    kept = np.where(LABEL == STRIP, NONE, 10).astype(np.int16)
    kept[0] = 10 + WRONG
    assert judged(0, -1.0, kept=kept) == []


def test_a_neighbour_that_the_left_right_check_rejected_is_no_evidence() -> None:
    kept = np.where(LABEL == WALL, NONE, 10).astype(np.int16)
    assert judged(0, -1.0, kept=kept) == []


@pytest.mark.parametrize(
    ("continuing", "places", "expected"),
    [(20, 20, False), (20, 50, True), (7, 7, False), (8, 60, False), (6, 20, False)],
)
def test_a_part_may_have_a_jump_that_few_of_all_places_show(continuing: int, places: int, expected: bool) -> None:
    assert may_have_parts(jumps(continuing, places), SIZES) is expected
    # For a segment of 2500 pixels, 20 places are few; a part of it may be smaller.
    assert may_have_parts(jumps(continuing, places), np.array([9999, 2500, 400], np.int32)) is (continuing == 20)


def test_nothing_is_asked_without_a_jump() -> None:
    none = Jumps(*(np.zeros(0, np.int64) for _ in range(5)))
    assert judged(0, -1.0, none) == []


def test_only_the_smaller_of_both_segments_is_rejected() -> None:
    """Where fringes repeat, the continued orders of both cost as little."""
    assert judged(0, 0.1, jumps(30, 30)) == [STRIP]
    assert judged(0, 0.1, jumps(30, 30), sizes=np.array([150, 200, 400], np.int32)) == [WALL]


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("exchanged", [False, True])
def test_rays_of_nearer_points_lie_in_the_direction_that_the_views_name(axis: str, exchanged: bool) -> None:
    made = reconstructor(axis)
    rig, views = made.calibration, (made.left, made.right)
    if exchanged:
        rig, views = rig.swapped(), views[::-1]
    middle = np.array([[size / 2 for size in rig.right.size]])
    ray = np.append(rig.right.normalise(middle)[0], 1.0)
    z = (rig.right.rotation @ np.array([0, 0, 1050.0]) + rig.right.translation)[2]
    points = np.stack([0.95 * z * ray, 1.05 * z * ray])
    near, far = rig.left.project((points - rig.right.translation) @ rig.right.rotation)
    assert np.sign((near - far)[views[0].first_axis]) == towards_nearer(*views)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_a_scene_that_both_cameras_see_loses_nothing(axis: str, monkeypatch: Any) -> None:
    made = reconstructor(axis)
    shown = images(pair("mixed"), axis)
    tested = made.reconstruct(*shown).points
    monkeypatch.setattr(OrderSearch, "reject_unseen", lambda *_: None)
    assert tested >= 0.999 * made.reconstruct(*shown).points
