"""Laws of the monotone fit and the monotone cubic."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from pipeline.calibrate.color.tone_response import LevelCurve, isotonic, monotone_cubic, response_of
from pipeline.common.errors import ImageError

values = arrays.arrays(np.float64, st.integers(2, 30), elements=st.floats(-10, 10))


@given(values)
def test_the_monotone_fit_never_falls_keeps_the_mean_and_does_not_change_what_rises(v):
    weights = np.linspace(1, 2, len(v))
    fitted = isotonic(v, weights)
    assert (np.diff(fitted) >= 0).all()
    assert np.average(fitted, weights=weights) == pytest.approx(np.average(v, weights=weights), abs=1e-9)
    assert np.allclose(isotonic(np.sort(v), weights), np.sort(v))


def test_a_value_without_weight_takes_that_of_its_neighbours():
    fitted = isotonic(np.array([0.0, 1.0, 0.2, 2.0]), np.array([1.0, 1.0, 1e-9, 1.0]))
    assert np.allclose(fitted, [0, 1, 1, 2], atol=1e-6)


@given(values)
def test_the_cubic_goes_through_its_points_and_is_monotone_between_them(v):
    x, y = np.arange(len(v), dtype=float) ** 1.3, np.sort(v)
    assert np.allclose(monotone_cubic(x, y, x), y)
    between = monotone_cubic(x, y, np.linspace(0, x[-1], 500))
    assert np.diff(between).min() >= -1e-9


def test_the_cubic_of_a_line_is_the_line():
    x = np.array([0.0, 1.0, 4.0, 9.0])
    at = np.linspace(0, 9, 50)
    assert np.allclose(monotone_cubic(x, 2 * x + 1, at), 2 * at + 1)


@pytest.mark.parametrize("gamma", [0.6, 1.0, 2.2, 2.8])
def test_seventeen_levels_give_a_power_law_within_a_fifth_of_a_percent(gamma):
    levels = np.rint(np.linspace(0, 255, 17))
    curve = LevelCurve(levels, (levels / 255) ** gamma, np.full(17, 1e-3))
    truth = (np.arange(256) / 255) ** gamma
    error = np.abs(response_of([[curve]] * 3).curves - truth).max()
    # A root rises too steeply at zero for any curve through points 16 levels apart.
    assert error < (0.03 if gamma < 1 else 0.002)


def test_two_cameras_are_weighted_by_their_noise():
    levels = np.array([0.0, 128, 255])
    good = LevelCurve(levels, np.array([0, 0.5, 1]), np.full(3, 1e-3))
    poor = LevelCurve(levels, np.array([0, 0.6, 1]), np.full(3, 1e-1))
    assert response_of([[good, poor]] * 3).light(np.full((1, 3), 128.0))[0, 0] / 255 == pytest.approx(0.5, abs=1e-3)


def test_light_that_falls_is_refused():
    levels = np.array([0.0, 85, 170, 255])
    curve = LevelCurve(levels, np.array([0, 0.8, 0.4, 1]), np.full(4, 1e-3))
    with pytest.raises(ImageError, match="red falls towards drive value 170"):
        response_of([[curve]] * 3)
