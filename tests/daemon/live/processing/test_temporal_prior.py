"""Which pairs may use the orders of the last pair as a prior."""

from __future__ import annotations

import pytest

from daemon.live.processing.temporal_prior import TemporalPrior

PERIOD_NS = 33_000_000


@pytest.mark.parametrize(
    ("seq", "periods", "stride", "usable"),
    [
        (11, 1, 1, True),
        (14, 4, 1, True),
        (16, 6, 1, True),  # 0.2 s are close, whatever the trigger's rate
        (18, 8, 1, False),
        (11, 1, 2, False),
        (9, 1, 1, False),
        (11, -1, 1, False),
        (10, 1, 1, False),
    ],
)
def test_the_prior_is_usable_if_little_time_has_passed(seq: int, periods: int, stride: int, usable: bool) -> None:
    prior = TemporalPrior()
    prior.measured(10, 0, 1)
    assert prior.usable(seq, periods * PERIOD_NS, stride) is usable


def test_a_slow_trigger_counts_in_periods() -> None:
    prior = TemporalPrior()
    prior.measured(10, 0, 1)
    assert prior.usable(12, 2_000_000_000, 1) and not prior.usable(15, 5_000_000_000, 1)


def test_numbers_wrap() -> None:
    prior = TemporalPrior()
    prior.measured(2**32 - 1, 0, 1)
    assert prior.usable(0, PERIOD_NS, 1)


def test_there_is_no_prior_at_the_start_and_after_a_change() -> None:
    prior = TemporalPrior()
    assert not prior.usable(0, 0, 1)
    prior.measured(0, 0, 1)
    prior.reset()
    assert not prior.usable(1, PERIOD_NS, 1)
