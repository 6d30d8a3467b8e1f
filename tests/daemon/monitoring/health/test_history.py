"""The history returns what was added, in intervals, and its memory is bounded."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.monitoring.health.history import SECONDS, History, summarised


def filled(values: list[float], *, hours: float = 2.0) -> History:
    made = History(2, hours)
    for second, value in enumerate(values):
        made.add(float(second + 1), np.array([value, -value], np.float32))
    return made


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.one_of(st.floats(-100, 100, width=32), st.just(float("nan"))), min_size=20, max_size=300),
    st.integers(2, 50),
)
def test_every_interval_lies_between_its_extremes(values: list[float], most: int) -> None:
    read = filled(values).read(float(len(values)), float(len(values)), [0, 1], most)
    assert len(read.times_s) <= most and read.mean.shape == (len(read.times_s), 2)
    known = np.isfinite(read.mean)
    assert (known == np.isfinite(read.low)).all() and (known == np.isfinite(read.high)).all()
    assert (read.low[known] <= read.mean[known] + 1e-3).all() and (read.mean[known] <= read.high[known] + 1e-3).all()
    finite = [v for v in values if np.isfinite(v)]
    assert known.any() == bool(finite)
    if finite:
        assert np.fmin.reduce(read.low[:, 0]) == pytest.approx(min(finite))
        assert np.fmax.reduce(read.high[:, 0]) == pytest.approx(max(finite))


def test_without_gaps_there_are_no_gaps() -> None:
    for count, span, most in ((300, 300, 300), (300, 300, 60), (7200, 7200, 600), (7200, 6000, 50)):
        read = filled([1.0] * count).read(float(count), float(span), [0], most)
        assert np.isfinite(read.mean).all() and (read.mean == 1.0).all(), (count, span, most)


def test_a_long_span_is_read_from_minutes_with_their_extremes() -> None:
    values = [0.0] * 7200
    values[1000] = 50.0  # older than the seconds that are kept
    read = filled(values).read(7200.0, 7200.0, [0], 60)
    assert read.high.max() == 50.0 and 0 < read.mean.max() < 1.0
    assert read.times_s[np.nanargmax(read.high)] == pytest.approx(1000, abs=read.period_s)


def test_memory_does_not_grow() -> None:
    made = filled([1.0] * 100)
    before = made.nbytes
    for second in range(2 * SECONDS):
        made.add(float(101 + second), np.zeros(2, np.float32))
    assert made.nbytes == before and made.rows == (SECONDS, 120)
    assert History(50, 72).nbytes < 5_000_000


def test_a_summary_of_unknown_values_is_unknown() -> None:
    rows = np.full((3, 2), np.nan, np.float32)
    rows[1, 1] = 4.0
    mean, low, high = summarised(rows)
    assert np.isnan([mean[0], low[0], high[0]]).all() and mean[1] == low[1] == high[1] == 4.0
