"""The fit of the border test: it finds coefficients that are known, and thinning changes no sum."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy.border_model import logistic, quadratic, squares, thinned, variance
from pipeline.filter.border.border_model import FIGURES

N = 40_000


def test_thinned_points_stand_for_all_of_their_kind() -> None:
    rng = np.random.default_rng(1)
    x = rng.normal(size=(N, FIGURES))
    ratio = np.where(rng.random(N) < 0.3, np.inf, 1.0)
    some, kept, weight = thinned(x, ratio)
    assert len(some) == len(kept) == len(weight) < N / 2
    for wrong in (True, False):
        total = np.isinf(ratio) == wrong
        assert weight[np.isinf(kept) == wrong].sum() == pytest.approx(total.sum() / np.sqrt(N), rel=0.03)


def test_a_pair_with_few_points_keeps_all() -> None:
    x, ratio = np.zeros((50, FIGURES)), np.r_[np.full(10, np.inf), np.ones(40)]
    some, kept, weight = thinned(x, ratio)
    assert some.shape == x.shape and (kept == ratio).all() and np.allclose(weight, 1 / np.sqrt(50))


def test_the_regression_finds_the_odds_that_made_the_points_wrong() -> None:
    rng = np.random.default_rng(2)
    x = rng.normal(size=(N, FIGURES))
    odds = -2 + 1.5 * x[:, 0] - 1.0 * x[:, 3] + 0.5 * x[:, 1] * x[:, 0]
    wrong = rng.random(N) < 1 / (1 + np.exp(-odds))
    found = quadratic(x) @ logistic(quadratic(x), wrong, np.ones(N))
    assert np.abs(found - odds).mean() < 0.3
    assert np.corrcoef(found, odds)[0, 1] > 0.98


def test_the_variance_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(3)
    x = rng.normal(size=(N, FIGURES))
    log_variance = 0.5 + 0.8 * x[:, 2] + 0.3 * x[:, 5] ** 2
    ratio = np.abs(rng.normal(size=N)) * np.exp(0.5 * log_variance)
    found = squares(x) @ variance(squares(x), ratio, np.ones(N))
    assert np.abs(found - log_variance).mean() < 0.1
