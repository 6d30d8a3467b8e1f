"""Links of lattice pixels: change of order and weight by the phase."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.fringe_order.phase_links import CONTRAST, column_links, contrast_factors

DOWN, STEP, ROWS, COLUMNS = 3, 2, 6, 5


def links(
    phase: NDArray[np.float64], brightness: NDArray[np.uint8] | None = None
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Change of order and weight of every lattice pixel and its upper neighbour, of an absolute phase."""
    wrapped = (phase - 2 * np.pi * np.rint(phase / (2 * np.pi))).astype(np.float32)
    count = np.full((ROWS, COLUMNS), 4, np.int32)
    jump, weight = np.empty((ROWS, COLUMNS), np.int32), np.empty((ROWS, COLUMNS), np.float32)
    valid = np.ones(wrapped.shape, np.bool_)
    brightness = np.full(wrapped.shape, 100, np.uint8) if brightness is None else brightness
    column_links(
        ROWS, wrapped, valid, brightness, np.float32(CONTRAST), 0, DOWN, 0, STEP, np.float32(0), count, jump, weight
    )
    return jump[1:], weight[1:]


@settings(max_examples=30, deadline=None)
@given(st.floats(-2.5, 2.5), st.floats(-30, 30))
def test_the_order_changes_where_the_wrapped_phase_does(slope: float, start: float) -> None:
    phase = start + np.arange(DOWN * ROWS)[:, None] * slope + np.zeros(STEP * COLUMNS)
    turns = np.rint(phase / (2 * np.pi))[::DOWN, ::STEP]
    close = np.abs(np.abs(phase[::DOWN, ::STEP] / (2 * np.pi) % 1 - 0.5)) < 1e-3  # either turn is right
    jump, weight = links(phase)
    unclear = close[1:] | close[:-1]
    np.testing.assert_array_equal(jump[~unclear], np.diff(turns, axis=0)[~unclear])
    assert (weight > 0.99).all()


@pytest.mark.parametrize("step", [0.5, 1.0, 3.0])
def test_a_link_counts_less_the_more_the_phase_breaks(step: float) -> None:
    phase = np.zeros((DOWN * ROWS, STEP * COLUMNS))
    phase[2 * DOWN + 2 :] = step
    weight = links(phase)[1]
    assert (np.delete(weight, 2, axis=0) > 0.99).all()
    assert weight[2] == pytest.approx(np.exp(-min(4 * step * step, 8)), abs=1e-3)


@pytest.mark.parametrize("other", [40, 90, 110, 160])
def test_a_link_counts_less_the_more_the_brightness_changes(other: int) -> None:
    phase = np.zeros((DOWN * ROWS, STEP * COLUMNS))
    brightness = np.full(phase.shape, 100, np.uint8)
    brightness[2 * DOWN + 2 :] = other
    jump, weight = links(phase, brightness)
    contrast = (other - 100) / (other + 132)
    assert (jump == 0).all()
    assert (np.delete(weight, 2, axis=0) > 0.99).all()
    assert weight[2] == pytest.approx(np.exp(-min(CONTRAST * contrast**2, 8)), abs=1e-3)


def factors(brightness: NDArray[np.float64]) -> NDArray[np.float64]:
    """Factors of the contrasts along rows and along columns."""
    counts = np.rint(brightness).astype(np.uint8)
    h, w = counts.shape[0] // DOWN, counts.shape[1] // STEP
    return np.array(contrast_factors(counts, np.ones(counts.shape, np.bool_), 0, DOWN, h, 0, STEP, w))


def test_contrasts_of_surfaces_count_and_fringes_that_are_left_in_the_brightness_do_not() -> None:
    i, j = np.indices((240, 320)).astype(np.float64)
    patches = np.where((i // 40 + j // 40) % 2 == 0, 60.0, 120.0)
    np.testing.assert_allclose(factors(patches), CONTRAST)
    along, across = factors(120 * (1 + 0.2 * np.cos(2 * np.pi * j / 9)))
    assert along < 0.1 * CONTRAST and across == pytest.approx(CONTRAST)
    along, across = factors(120 * (1 + 0.2 * np.cos(2 * np.pi * i / 9)))
    assert across < 0.1 * CONTRAST and along == pytest.approx(CONTRAST)


def test_an_image_without_a_valid_pixel_has_the_full_factor() -> None:
    counts, nothing = np.zeros((30, 30), np.uint8), np.zeros((30, 30), np.bool_)
    np.testing.assert_allclose(contrast_factors(counts, nothing, 0, DOWN, 10, 0, STEP, 15), CONTRAST)
