"""No wrong pair, and every frame accounted for by name, whatever the cameras do."""

from __future__ import annotations

from collections import Counter

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.pairing_events import Event, FrameOutcome, Lost, PairingSettings, Resynced
from daemon.live.items import Pair
from drivers.protocols import TRIGGER_MODULUS, Frame
from tests.daemon.live.acquisition.trigger_storm import PERIOD_NS, Faults, Sent, _frame, storm

CALM = Faults(0, 0, 0, 0, 0, 0, 0)


def play(sent: list[Sent], pairer: Pairer) -> list[Event]:
    events = [event for item in sent for event in pairer.feed(item.frame)]
    return [*events, *pairer.flush()]


def check(sent: list[Sent], events: list[Event], pairer: Pairer) -> list[Pair]:
    """The two laws; returns the pairs."""
    pairs = [event for event in events if isinstance(event, Pair)]
    truth = {(s.frame.side, s.frame.t_exposure_ns): s.exposure for s in sent}
    for pair in pairs:
        assert pair.left.side == "left" and pair.right.side == "right"
        assert pair.left.trigger == pair.right.trigger
        left, right = (truth[f.side, f.t_exposure_ns] for f in (pair.left, pair.right))
        assert left == right, f"pair of exposures {left} and {right}"
    lost = [event for event in events if isinstance(event, Lost)]
    assert 2 * len(pairs) + len(lost) == len(sent)
    counts = Counter(event.outcome for event in lost) + Counter({FrameOutcome.PAIRED: 2 * len(pairs)})
    assert counts == pairer.outcomes["left"] + pairer.outcomes["right"]
    assert pairer.waiting == 0
    return pairs


def test_ten_thousand_triggers_with_every_fault_give_no_wrong_pair_and_an_outcome_for_every_frame() -> None:
    sent = storm(10_000, Faults(extra_first=("right",)), seed=5)
    pairer = Pairer()
    events = play(sent, pairer)
    pairs = check(sent, events, pairer)
    assert len(pairs) > 8_000
    seen = {event.outcome for event in events if isinstance(event, Lost)}
    assert seen >= {
        FrameOutcome.PARTNER_MISSING,
        FrameOutcome.LATE,
        FrameOutcome.DUPLICATE,
        FrameOutcome.TRIGGER_MISMATCH,
        FrameOutcome.TIMESTAMP_MISMATCH,
    }
    assert any(isinstance(event, Resynced) for event in events)


def test_calm_cameras_pair_every_trigger() -> None:
    sent, pairer = storm(100, CALM), Pairer()
    assert [pair.seq for pair in check(sent, play(sent, pairer), pairer)] == list(range(100))


def test_numbers_wrap_without_a_gap() -> None:
    sent, pairer = storm(20, Faults(0, 0, 0, 0, 0, 0, 0, start=TRIGGER_MODULUS - 7)), Pairer()
    numbers = [pair.seq for pair in check(sent, play(sent, pairer), pairer)]
    assert len(numbers) == 20 and numbers[6:8] == [TRIGGER_MODULUS - 1, 0]


@pytest.mark.parametrize("side", ["left", "right"])
def test_an_extra_first_frame_shifts_one_count_and_is_found_out_by_time(side: str) -> None:
    sent, pairer = storm(50, Faults(0, 0, 0, 0, 0, 0, 0, extra_first=(side,))), Pairer()  # type: ignore[arg-type]
    pairs = check(sent, play(sent, pairer), pairer)
    assert len(pairs) == 50
    assert pairer.shift == (1 if side == "right" else TRIGGER_MODULUS - 1)


def test_one_wrong_number_costs_at_most_two_pairs_and_changes_no_shift() -> None:
    frames = [_frame(side, k + 5 * (k == 4 and side == "left"), k * PERIOD_NS, 1) for k in range(40) for side in _BOTH]
    sent, pairer = [Sent(frame, k // 2) for k, frame in enumerate(frames)], Pairer()
    pairs = check(sent, play(sent, pairer), pairer)
    assert len(pairs) == 38 and pairer.shift == 0
    assert pairer.outcomes["left"][FrameOutcome.TRIGGER_MISMATCH] == 1


_BOTH = ("left", "right")


def test_the_number_alone_makes_no_pair() -> None:
    pairer = Pairer()
    events = pairer.feed(_frame("left", 1, 0, 1)) + pairer.feed(_frame("right", 1, PERIOD_NS, 1))
    assert events == []
    assert {e.outcome for e in pairer.tick(10**15) if isinstance(e, Lost)} == {FrameOutcome.TIMESTAMP_MISMATCH}


def test_the_time_alone_makes_no_pair() -> None:
    pairer = Pairer()
    assert pairer.feed(_frame("left", 1, 0, 1)) + pairer.feed(_frame("right", 2, 0, 1)) == []
    assert {e.outcome for e in pairer.tick(10**15) if isinstance(e, Lost)} == {FrameOutcome.TRIGGER_MISMATCH}


def test_triggers_slower_than_the_waiting_time_still_pair() -> None:
    slow = [_frame(side, k, k * 200 * PERIOD_NS, 1) for k in range(20) for side in _BOTH]
    sent, pairer = [Sent(frame, k // 2) for k, frame in enumerate(slow)], Pairer()
    assert len(check(sent, play(sent, pairer), pairer)) >= 18


def test_after_a_restart_of_a_camera_its_count_is_confirmed_first() -> None:
    pairer = Pairer()
    for k in range(5):
        pairer.feed(_frame("left", k, k * PERIOD_NS, 1))
        pairer.feed(_frame("right", k, k * PERIOD_NS, 1))
    pairer.camera_restarted("left")
    fed = [pairer.feed(_frame(side, k, k * PERIOD_NS, 1)) for k in range(5, 8) for side in _BOTH]
    assert fed[:5] == [[]] * 5 and len(fed[5]) == 3


@pytest.mark.parametrize("side", _BOTH)
def test_a_camera_that_counts_from_zero_again_costs_only_the_sightings_that_confirm_it(side: str) -> None:
    """Numbers that it used up to a moment ago come again: they are no evidence against the new ones after a restart."""
    sent = [Sent(_frame(s, k, k * PERIOD_NS, 1), k) for k in range(10) for s in _BOTH]
    pairer = Pairer()
    assert len(check(sent, play(sent, pairer), pairer)) == 10
    pairer.camera_restarted(side)
    again = [Sent(_frame(s, k - 12 * (s == side), k * PERIOD_NS, 1), k) for k in range(12, 30) for s in _BOTH]
    events = play(again, pairer)
    pairs = [event for event in events if isinstance(event, Pair)]
    assert len(pairs) == len(again) // 2
    assert all(pair.left.t_exposure_ns == pair.right.t_exposure_ns for pair in pairs)


def test_frames_before_the_other_camera_runs_are_named_so() -> None:
    pairer = Pairer()
    events = [event for k in range(60) for event in pairer.feed(_frame("left", k, k * PERIOD_NS, 1))]
    assert {event.outcome for event in events if isinstance(event, Lost)} <= {FrameOutcome.BEFORE_SYNC}
    assert pairer.waiting <= pairer.settings.capacity


def test_a_frame_that_lay_around_for_long_is_stale() -> None:
    pairer = Pairer()
    (event,) = pairer.feed(_frame("left", 1, 0, 6_000_000_000))
    assert isinstance(event, Lost) and event.outcome is FrameOutcome.STALE


def test_a_camera_that_restarts_its_count_does_not_move_the_numbers_of_the_pairs() -> None:
    sent = []
    for k in range(40):
        sent.append(Sent(_frame("left", 1000 + k if k < 20 else k - 20, k * PERIOD_NS, 1), k))
        sent.append(Sent(_frame("right", 1000 + k, k * PERIOD_NS, 2), k))
    pairer = Pairer()
    pairs = check(sent, play(sent, pairer), pairer)
    assert [pair.seq for pair in pairs] == list(range(1000, 1040))


chance = st.sampled_from([0.0, 0.01, 0.1, 0.3])


@settings(max_examples=60, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    chances=st.tuples(chance, chance, chance, chance, st.sampled_from([0.0, 0.01, 0.1])),
    gone=st.sampled_from([0.0, 0.02]),
    extra=st.sampled_from([(), ("left",), ("right",), ("left", "right")]),
    start=st.sampled_from([0, 1, TRIGGER_MODULUS - 3]),
    capacity=st.integers(1, 12),
)
def test_any_storm_of_faults_keeps_both_laws(seed, chances, gone, extra, start, capacity) -> None:  # type: ignore[no-untyped-def]
    faults = Faults(*chances, blackout=0.02, gone=gone, extra_first=extra, start=start)
    sent, pairer = storm(60, faults, seed), Pairer(PairingSettings(capacity=capacity))
    check(sent, play(sent, pairer), pairer)


def test_no_reference_to_a_frame_is_kept_after_its_outcome() -> None:
    pairer = Pairer()
    for k in range(2000):
        pairer.feed(_frame("left", k, k * PERIOD_NS, 1))
    held = [guest for camera in pairer._cameras.values() for guest in camera.waiting]
    assert len(held) <= pairer.settings.capacity and all(isinstance(guest.frame, Frame) for guest in held)
