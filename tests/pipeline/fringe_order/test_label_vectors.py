"""Path steps and least totals on vectors of labels, against the same sums in NumPy."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pipeline.common.jit import serial
from pipeline.fringe_order.label_vectors import LANES, advance, least_two, padded

COUNTS = [LANES, 3 * LANES, 8 * LANES]


@serial
def _advance(
    costs: Any, at: int, paths: Any, old: int, new: int, least: Any, penalty: Any, keep: Any, total: Any, labels: int
) -> Any:
    return advance(costs, at, paths, old, new, least, penalty, keep, total, labels)


@serial
def _least_two(total: Any, at: int, labels: int) -> Any:
    return least_two(total, at, labels)


def test_labels_are_kept_in_whole_vectors() -> None:
    for labels in range(1, 70):
        assert padded(labels) % LANES == 0 and labels <= padded(labels) < labels + LANES


@pytest.mark.parametrize("labels", COUNTS)
@pytest.mark.parametrize("keep", [0, 1])
def test_a_step_adds_the_lesser_of_the_neighbours_cost_and_the_penalty(labels: int, keep: int) -> None:
    rng = np.random.default_rng(labels)
    costs, total, paths = (rng.random(n, np.float32) for n in (3 * labels, 3 * labels, 6 * labels))
    before_total, before_paths = total.copy(), paths.copy()
    least, penalty = np.float32(0.25), np.float32(0.4)
    # An odd first label of the neighbour: a change of the first order displaces it by any number.
    at, old, new = labels, labels + 3, 4 * labels
    found = _advance(costs, at, paths, old, new, least, penalty, np.float32(keep), total, labels)

    here = np.s_[at : at + labels]
    value = costs[here] + np.minimum(before_paths[old : old + labels] - least, penalty)
    assert found == pytest.approx(value.min(), abs=1e-6)
    np.testing.assert_allclose(paths[new : new + labels], value, atol=1e-6)
    np.testing.assert_allclose(total[here], keep * before_total[here] + value, atol=1e-6)
    outside = np.ones(len(total), bool)
    outside[here] = False
    np.testing.assert_array_equal(total[outside], before_total[outside])
    untouched = np.ones(len(paths), bool)
    untouched[new : new + labels] = False
    np.testing.assert_array_equal(paths[untouched], before_paths[untouched])


@pytest.mark.parametrize("labels", COUNTS)
def test_the_first_of_the_least_values_and_its_lead_are_found(labels: int) -> None:
    rng = np.random.default_rng(labels)
    for trial in range(200):
        # Few different values: the least one is often there several times, in one vector or in several.
        total = rng.integers(0, 2 + trial, 3 * labels).astype(np.float32)
        own = total[labels : 2 * labels]
        where, lead = _least_two(total, labels, labels)
        assert where == np.argmin(own)
        assert lead == np.partition(own, 1)[1] - own.min()
