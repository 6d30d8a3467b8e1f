"""A delivered pair always shows the requested image, for any faults of the devices."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.live.projection.confirmed_capture import CaptureCancelledError, ConfirmedCapture, settling_ns
from drivers.errors import DriverError
from tests.daemon.live.projection.virtual_time import MS, Bench, image, level


def capture_on(bench: Bench, **options: object) -> ConfirmedCapture:
    settle_ns = settling_ns(bench.open(), tolerance_ns=2 * MS)
    return ConfirmedCapture(bench, bench.open(), bench, clock=bench, settle_ns=settle_ns, **options)


@settings(max_examples=60, deadline=None)
@given(
    latency_ms=st.floats(0.0, 120.0),
    known=st.booleans(),
    period_ms=st.floats(9.0, 200.0),
    exposure_ms=st.floats(0.2, 8.0),
    show_ms=st.floats(0.0, 60.0),
    lost=st.sampled_from([0.0, 0.1, 0.4]),
    late_ms=st.sampled_from([0.0, 30.0, 150.0]),
    jitter_us=st.sampled_from([0.0, 900.0]),
    levels=st.lists(st.integers(1, 250), min_size=1, max_size=12),
    seed=st.integers(0, 10_000),
)
def test_every_pair_shows_the_requested_image_and_both_frames_are_of_one_trigger(
    latency_ms: float,
    known: bool,
    period_ms: float,
    exposure_ms: float,
    show_ms: float,
    lost: float,
    late_ms: float,
    jitter_us: float,
    levels: list[int],
    seed: int,
) -> None:
    bench = Bench(
        latency_ms=latency_ms,
        reported_ms=latency_ms if known else None,
        period_ms=period_ms,
        exposure_ms=exposure_ms,
        show_ms=show_ms,
        lost=lost,
        late_ms=late_ms,
        jitter_us=jitter_us,
        seed=seed,
    )
    taken = list(capture_on(bench, patience_s=60.0).each(image(value) for value in levels))
    assert len(taken) == len(levels)
    for value, pair in zip(levels, taken, strict=True):
        assert pair.left.trigger == pair.right.trigger
        assert level(pair) == {value}
    numbers = [pair.seq for pair in taken]
    assert numbers == sorted(set(numbers)), "no pair is handed out twice"


def test_counting_frames_instead_of_reading_times_would_take_wrong_images() -> None:
    """The first pair after the flip, which a naive capture uses, is often wrong."""
    bench = Bench(latency_ms=40.0, period_ms=20.0)
    wrong = 0
    for value in range(1, 21):
        bench.show(image(value))
        pair = bench.get(1.0)
        wrong += pair is None or level(pair) != {value}
    assert wrong == 20


def test_an_image_that_is_shown_already_is_not_sent_again_and_its_pairs_are_new() -> None:
    bench = Bench()
    capture = capture_on(bench)
    capture.show(image(9))
    first = capture.pair()
    now_ns = bench.now_ns
    capture.show(image(9))
    second = capture.pair()
    assert bench.shown == 1 and first.seq < second.seq and second.left.t_exposure_ns >= now_ns


def test_an_unknown_latency_costs_only_time() -> None:
    fast, slow = Bench(reported_ms=20.0), Bench(reported_ms=None)
    for bench in (fast, slow):
        list(capture_on(bench).each([image(1), image(2)]))
    assert slow.now_ns - fast.now_ns > 400 * MS


def test_a_clock_that_was_set_back_costs_one_attempt() -> None:
    bench = Bench()
    capture = capture_on(bench, patience_s=1.0)
    capture.show(image(1))
    capture._lit_ns += 3_600_000_000_000
    with pytest.raises(DriverError, match="were exposed too early"):
        capture.pair()
    assert bench.monotonic_ns() < 3_000 * MS
    capture.show(image(1))
    assert level(capture.pair()) == {1}


def test_cameras_without_triggers_are_reported() -> None:
    bench = Bench(lost=1.0)
    capture = capture_on(bench, patience_s=1.0)
    capture.show(image(1))
    with pytest.raises(DriverError, match=r"no pair of images came within 1 s \(0 were exposed too early\)"):
        capture.pair()


def test_a_projector_in_trouble_or_started_again_spoils_what_was_captured_meanwhile() -> None:
    bench = Bench()
    capture = capture_on(bench)
    capture.show(image(1))
    bench.trouble = "no image: the window is gone"
    with pytest.raises(DriverError, match=r"the window is gone; what was captured meanwhile does not count"):
        capture.pair()
    bench.trouble = ""
    capture.show(image(1))
    assert bench.shown == 2, "after trouble the image is shown again"
    bench.counted["restarts"] += 1
    with pytest.raises(DriverError, match="started again"):
        capture.show(image(2))
    capture.show(image(2))
    assert level(capture.pair()) == {2}


def test_a_cancelled_capture_ends() -> None:
    bench = Bench()
    capture = capture_on(bench, cancelled=lambda: bench.now_ns > 0)
    capture.show(image(1))
    with pytest.raises(CaptureCancelledError):
        capture.pair()


def test_a_projector_that_cannot_show_other_images_is_refused() -> None:
    bench = Bench()
    bench.fixed_image = True
    with pytest.raises(DriverError, match="cannot show another"):
        capture_on(bench)
