"""Windows over pairs and clouds: rates, percentiles, residual and jitter."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.monitoring.health.observe.counter_rates import CounterRates
from daemon.monitoring.health.observe.frame_statistics import KEPT, FrameStatistics, spread
from tests.daemon.monitoring.health.samples import camera, cloud, pair, status

S = 1_000_000_000


def test_residual_and_jitter_are_those_of_the_exposures() -> None:
    frames, rng = FrameStatistics(), np.random.default_rng(1)
    shake = np.round(rng.normal(0, 200_000, 400)).astype(int)
    for n in range(400):
        frames.pair(pair(n, n * S // 20 + int(shake[n]), residual_ns=300_000 if n % 2 else 302_000), n * S // 20)
    values = frames.values(399 * S // 20, 20.0)
    assert values["pairing_residual_us"] == pytest.approx(301, abs=1.1)
    assert values["pairing_spread_us"] == pytest.approx(1, abs=1.1)
    assert values["trigger_interval_ms"] == pytest.approx(50, abs=0.1)
    # Each interval ends twice.
    assert values["trigger_jitter_us"] == pytest.approx(200 * np.sqrt(2), rel=0.15)


@settings(max_examples=25, deadline=None)
@given(st.sets(st.integers(0, 199), max_size=150), st.integers(0, 2**32 - 1))
def test_lost_triggers_are_no_jitter_and_numbers_may_wrap(lost: set[int], first: int) -> None:
    frames = FrameStatistics()
    for n in sorted(set(range(200)) - lost):
        frames.pair(pair(first + n, n * S // 10), 1)
    values = frames.values(2, 1.0)
    if "trigger_jitter_us" in values:
        assert values["trigger_jitter_us"] == 0 and values["trigger_interval_ms"] == 100


def test_only_the_window_counts() -> None:
    frames = FrameStatistics()
    for n in range(30):
        frames.cloud(cloud(n, 0, latency_ms=1000.0 if n < 20 else 40.0, ms={"decode": float(n)}), n * S)
    values = frames.values(29 * S, 10.0)
    assert values["latency_p99_ms"] == 40.0 and values["arrival_p99_ms"] == pytest.approx(32.0)
    window = frames.window(29 * S, 60.0)
    assert window["clouds"] == 30 and window["latency_ms"]["max"] == 1000.0
    assert window["stages_ms"]["decode"]["p50"] == 15.0
    frames.clear()
    assert frames.values(29 * S, 10.0) == {} and frames.window(29 * S, 60.0)["latency_ms"] == {}


def test_what_is_kept_is_bounded() -> None:
    frames, item = FrameStatistics(), pair(0, 0)
    for _ in range(KEPT + 10):
        frames.pair(item, 5)
    assert frames.window(6, 1.0)["pairs"] == KEPT


def test_percentiles_of_nothing_are_nothing() -> None:
    assert spread([]) == {} and spread([3.0])["p99"] == 3.0


def test_counts_that_grow_become_shares_and_rates() -> None:
    deltas = CounterRates()
    for second in range(8):
        fates = {"paired": 90 * second, "partner_missing": 10 * second, "waiting": 3}
        drops = {"pairs_not_ready": 15, "pairs_pipeline_busy": 20 * second, "pairs_recorder_busy": 5 * second}
        cameras = {side: camera(fates=fates) for side in ("left", "right")}
        deltas.add(float(second), status(pairs=100 * second, drops=drops, cameras=cameras))
    values = deltas.values(7.0, 5.0)
    assert values == {"dropped_share": 0.2, "lone_share": 0.1, "refused_hz": 5.0}
    assert deltas.drops(7.0, 5.0) == {"pairs_pipeline_busy": 20.0, "pairs_recorder_busy": 5.0}
    assert CounterRates().values(1.0, 5.0) == {}
