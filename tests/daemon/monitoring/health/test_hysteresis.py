"""Laws of a limit: it is raised late, cleared later, and never flickers."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.monitoring.health.hysteresis import UNKNOWN_S, Hysteresis
from tests.daemon.monitoring.health.samples import config

CONFIG = config(raise_s=3.0, clear_s=5.0, margin=0.1)
LIMIT = 100.0
VALUES = st.lists(st.one_of(st.floats(0, 300), st.just(math.nan)), max_size=200)


def changes(values: list[float], *, below: bool = False) -> list[tuple[int, str]]:
    """Second and kind of every change, one value a second."""
    state = Hysteresis()
    fed = [(second, state.feed(second, value, LIMIT, CONFIG, below=below)) for second, value in enumerate(values)]
    return [(second, change) for second, change in fed if change is not None]


@settings(max_examples=80, deadline=None)
@given(VALUES, st.booleans())
def test_it_is_raised_only_after_seconds_beyond_and_cleared_only_after_seconds_well_within(
    values: list[float], below: bool
) -> None:
    raised = changes(values, below=below)
    kinds = [change for _, change in raised]
    assert kinds[::2] == ["raised"] * len(kinds[::2]) and "raised" not in kinds[1::2]
    for second, change in raised:
        if change == "raised":
            recent = values[second - 3 : second + 1]
            assert len(recent) == 4 and all(v < LIMIT if below else v > LIMIT for v in recent)
        elif change == "cleared":
            recent = values[second - 5 : second + 1]
            assert len(recent) == 6 and all(v >= 110.0 - 1e-9 if below else v <= 90.0 for v in recent)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(90.0, 300.0, exclude_min=True), min_size=1, max_size=100))
def test_what_is_open_stays_open_while_the_value_is_not_well_within(values: list[float]) -> None:
    assert changes([200.0] * 4 + values) == [(3, "raised")]


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 100.0), max_size=100))
def test_within_the_limit_nothing_is_raised(values: list[float]) -> None:
    assert changes(values) == []


def test_an_unknown_value_is_neither_ill_nor_healthy() -> None:
    assert changes([math.nan] * 200) == []
    raised = changes([200.0] * 4 + [math.nan] * 100)
    assert raised == [(3, "raised"), (3 + round(UNKNOWN_S), "unknown")]
    assert changes([200.0] * 4 + [math.nan] * 30 + [0.0] * 6) == [(3, "raised"), (39, "cleared")]


@pytest.mark.parametrize(("value", "expected"), [(0.0, []), (0.1, [(3, "raised")])])
def test_a_limit_of_zero(value: float, expected: list[tuple[int, str]]) -> None:
    state = Hysteresis()
    found = [(second, state.feed(second, value, 0.0, CONFIG)) for second in range(8)]
    assert [one for one in found if one[1]] == expected
    assert [state.feed(8 + n, 0.0, 0.0, CONFIG) for n in range(6)][-1] == ("cleared" if expected else None)
