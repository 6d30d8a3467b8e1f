"""Tests of small surfaces as a whole: their surroundings, their width, what the border test left of them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.filter.surfaces.small_surfaces import (
    LARGEST_LOSS,
    LEAST_WIDTH,
    MOST_CONTRADICTED,
    RADIUS,
    RELIABLE,
    narrow,
    reject_contradicted,
    reject_eroded,
)

Mask = NDArray[np.uint8]
SHAPE = (80, 160)
SMALLEST = 30


def mask(*boxes: Any) -> Mask:
    """Valid pixels: those of rectangles, (rows, columns) slices."""
    out = np.zeros(SHAPE, np.uint8)
    for box in boxes:
        out[box] = 1
    return out


def surfaces_of(valid: Mask) -> Surfaces:
    """Pixels that touch belong together."""
    found = Surfaces(SHAPE)
    found.find(valid, np.full(SHAPE, 3, np.uint8), SMALLEST)
    return found


def labels(valid: Mask) -> NDArray[np.uint16]:
    label = np.zeros(SHAPE, np.uint16)
    surfaces_of(valid).paint(label)
    return label


def after_contradiction(before: Mask, valid: Mask, **options: int) -> Mask:
    remaining, label = valid.copy(), labels(before)
    settings = {"large": 10_000, "stride": 1} | options
    reject_contradicted(before, remaining, label, surfaces_of(valid), **settings)
    return remaining


def test_remains_are_rejected_when_most_of_their_surroundings_were() -> None:
    before = mask(np.s_[20:60, 20:60])
    remains = mask(np.s_[35:45, 35:45])
    assert not after_contradiction(before, remains).any()
    # A surface that lost a rim of two pixels keeps the rest.
    kept = mask(np.s_[22:58, 22:58])
    np.testing.assert_array_equal(after_contradiction(before, kept), kept)


def test_the_share_decides() -> None:
    before = mask(np.s_[30:50, 20:60])
    for share, stays in ((MOST_CONTRADICTED - 0.06, True), (MOST_CONTRADICTED + 0.06, False)):
        # Columns that are within the radius of the rest, so that all of the surface are its surroundings.
        columns = round(2 * RADIUS * (1 - share))
        narrow = mask(np.s_[30:50, 20 : 20 + 2 * RADIUS])
        valid = mask(np.s_[30:50, 20 : 20 + columns])
        assert after_contradiction(narrow, valid).any() == stays
    assert before.any()


def test_other_surfaces_and_farther_pixels_do_not_count() -> None:
    remains = np.s_[35:45, 35:45]
    other = np.s_[35:45, 47:80]  # a gap of two columns: another surface, all of which was rejected
    kept = mask(remains)
    np.testing.assert_array_equal(after_contradiction(mask(remains, other), kept), kept)
    far = mask(np.s_[35:45, 35:150])
    near_kept = mask(np.s_[35:45, 35 : 140 - 2 * RADIUS])
    np.testing.assert_array_equal(after_contradiction(far, near_kept), near_kept)


def test_large_surfaces_are_not_tested_and_a_stride_shortens_the_radius() -> None:
    before, remains = mask(np.s_[20:60, 20:60]), mask(np.s_[35:45, 35:45])
    np.testing.assert_array_equal(after_contradiction(before, remains, large=100), remains)
    np.testing.assert_array_equal(after_contradiction(before, remains, stride=RADIUS), remains)


def test_an_image_without_surfaces_passes() -> None:
    empty = mask()
    assert not after_contradiction(empty, empty).any()


@pytest.mark.parametrize("turned", [False, True])
def test_small_surfaces_may_be_narrow(turned: bool) -> None:
    width = int(LEAST_WIDTH)
    valid = mask(np.s_[5 : 5 + width - 1, 10:70], np.s_[20 : 20 + width + 1, 10:70])
    if turned:
        valid = np.ascontiguousarray(np.pad(valid[:, :80].T, ((0, 0), (0, 80))))
    by_size = np.argsort(surfaces_of(valid).sizes)
    np.testing.assert_array_equal(narrow(surfaces_of(valid), SMALLEST, 1)[by_size], [True, False])
    # Every second pixel of a surface of twice the width.
    assert not narrow(surfaces_of(valid), SMALLEST, 2).any()


def test_a_long_narrow_surface_is_large_enough() -> None:
    valid = mask(np.s_[5:8, 5:155])
    assert valid.sum() > RELIABLE * SMALLEST
    assert not narrow(surfaces_of(valid), SMALLEST, 1).any()


def test_small_surfaces_that_the_border_test_eroded_are_rejected() -> None:
    valid = mask(np.s_[5:15, 10:20], np.s_[40:60, 10:60])
    for lost, stays in ((LARGEST_LOSS - 0.05, True), (LARGEST_LOSS + 0.05, False)):
        remaining = valid.copy()
        remaining[5:15, 10:20].flat[: round(lost * 100)] = 0
        remaining[40:50, 10:60] = 0  # half of a large surface
        reject_eroded(remaining, surfaces_of(valid), SMALLEST)
        assert remaining[5:15, 10:20].any() == stays
        assert remaining[50:60, 10:60].all()
