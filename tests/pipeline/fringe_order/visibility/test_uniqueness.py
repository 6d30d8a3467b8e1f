"""Uniqueness of fringe orders in the other image: claims agree with the match, and the cheaper surface stays."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.common.stopwatch import Stopwatch
from pipeline.fringe_order import order_search
from pipeline.fringe_order.semi_global_aggregation import NONE
from pipeline.fringe_order.visibility import uniqueness
from pipeline.match.match_result import PIXEL_STEPS
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from tests.pipeline.small import images, pair, reconstructor

_LIMIT = np.float32(1.5)


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_only_orders_with_a_cheaper_one_of_another_surface_at_their_place_are_rejected(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, places = 80, 15
    place = rng.integers(-1, places, n).astype(np.int32)
    value = rng.uniform(-4, 4, n).astype(np.float32)
    cost = rng.integers(0, 6, n).astype(np.float32)
    order = np.where(rng.random(n) < 0.2, NONE, 7).astype(np.int16)
    expected = order.copy()
    for b in np.flatnonzero(place >= 0):
        here = np.flatnonzero(place == place[b])
        best = here[np.argmin(cost[here])]
        if cost[best] < cost[b] and abs(value[best] - value[b]) >= _LIMIT:
            expected[b] = NONE
    uniqueness.reject_contradicted(place, value, cost, _LIMIT, np.empty(places, np.int32), order)
    np.testing.assert_array_equal(order, expected)


@pytest.mark.parametrize("axis", ["x", "y"])
def test_claims_lead_to_the_matched_pixels_at_the_cost_of_the_search(axis: str, monkeypatch: Any) -> None:
    made = reconstructor(axis)
    shown = images(pair("mixed"), axis)
    made.reconstruct(*shown)
    # Without certain orders the search itself has every pixel's costs.
    monkeypatch.setattr(order_search, "interpolate_orders", lambda *arguments: arguments[-1].fill(NONE))
    left, right, orders = made.orders(*shown, Stopwatch(None))
    searches, other = made.searches, made.right.table
    search, order = searches[0]._fine, searches[0]._fine.order
    place, value, cost = claims_of(made, left, right, monkeypatch)
    several = (search.count > 1) & (order != NONE) & (place >= 0)
    assert several.mean() > 0.3
    searched = search.costs[(search.place + order - search.first)[several]]
    np.testing.assert_allclose(cost[several], searched, atol=1e-3)

    # The match finds the same places, and the right camera's search the same absolute phases there.
    match = made.stage(1).match(left, right, orders, made.correction)
    own = made.left.table
    nodes = np.ix_(own.top + own.down * np.arange(order.shape[0]), own.left + own.step * np.arange(order.shape[1]))
    same = (match.valid[nodes] > 0) & (orders[nodes] == order) & (place >= 0)
    x, y = (plane[nodes].astype(float) / PIXEL_STEPS - 0.5 for plane in (match.right_u, match.right_v))
    row, column = np.divmod(place, other.shape[1])
    assert np.quantile(np.abs(other.left + other.step * column - x)[same], 0.98) < other.step / 2 + 1
    assert np.quantile(np.abs(other.top + other.down * row - y)[same], 0.98) < other.down / 2 + 1
    theirs = searches[1]._fine.order[row, column]
    i, j = other.top + other.down * row, other.left + other.step * column
    there = right.phase[i, j] + 2 * np.pi * theirs - made.right.slopes[0] * j - made.right.slopes[1] * i
    some = same & (theirs != NONE)  # elsewhere values are those that the memory had
    apart = np.abs(there[some] - value[some])
    assert np.mean(apart < made.settings.consistency_threshold) > 0.95
    assert np.median(apart) < 0.3


def claims_of(made: Reconstructor, left: Any, right: Any, monkeypatch: Any) -> list[Any]:
    """Place, value and cost of the last search's orders."""
    found: list[Any] = []
    claims = uniqueness.claims

    def noted(*arguments: Any) -> None:
        claims(*arguments)
        found.extend(arguments[-3:])

    with monkeypatch.context() as patch:
        patch.setattr(uniqueness, "claims", noted)
        kept = made.searches[0]._fine.order.copy()
        made.searches[0].reject_contradicted(left, right, made.correction, made.right, kept)
    return found


def test_orders_must_be_unique_only_where_the_fringes_repeat(monkeypatch: Any) -> None:
    asked: list[bool] = []
    monkeypatch.setattr(order_search.OrderSearch, "reject_contradicted", lambda *_: asked.append(True))
    for fraction, expected in ((0.382, False), (0.5, True)):
        layout = replace(RigLayout(), projector_fraction=fraction).scaled(0.25)
        made = Reconstructor(layout.calibration_for(Optics()), layout.pattern(24.0), layout.volume())
        made.reconstruct(
            *(np.zeros((*camera.size[::-1], 3), np.uint8) for camera in (made.calibration.left, made.calibration.right))
        )
        assert bool(asked) == expected
