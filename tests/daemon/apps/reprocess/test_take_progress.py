"""Whatever order chunks end in, every result that counts began with the state that the chunk before it left."""

from __future__ import annotations

import random

import pytest

from daemon.apps.reprocess.carried_state import CarriedState
from daemon.apps.reprocess.take_progress import TakeProgress

START = CarriedState()


def settled(value: float, encoding: str = "rgb8") -> CarriedState:
    return CarriedState(encoding, (((value, 0.0, 0.0), True),))


def unsettled(value: float) -> CarriedState:
    return CarriedState("rgb8", (((value, 0.0, 0.0), False),))


def after(number: int, before: CarriedState, changes: dict[int, CarriedState]) -> CarriedState:
    """The state after a chunk: chunks in ``changes`` set it, others keep it."""
    return changes.get(number, before)


def simulated(chunks: int, changes: dict[int, CarriedState], rng: random.Random) -> tuple[dict, int]:
    """Run chunks in random order; returns before and after of the result that stands for each, and all runs."""
    progress, running, results, runs = TakeProgress(chunks), [], {}, 0
    while not progress.complete:
        for number, before in list(progress.ready()):
            if rng.random() < 0.7 or not running:
                progress.started(number)
                running.append((number, before))
        number, before = running.pop(rng.randrange(len(running)))
        results[number] = before, after(number, before, changes)
        runs += 1
        progress.done(number, *results[number])
    return results, runs


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.parametrize(
    "changes",
    [
        {0: settled(0.5)},
        {0: unsettled(0.0), 3: settled(1.0)},
        {0: settled(0.5), 4: settled(0.1, "bayer_rggb8"), 7: settled(0.5)},
    ],
)
def test_the_results_form_one_chain(seed: int, changes: dict[int, CarriedState]) -> None:
    results, runs = simulated(10, changes, random.Random(seed))
    state = START
    for number in range(10):
        assert results[number] == (state, after(number, state, changes))
        state = results[number][1]
    if len(changes) == 1:
        assert runs == 10


def test_all_chunks_start_once_the_first_is_done_and_none_before() -> None:
    progress = TakeProgress(5)
    assert [number for number, _ in progress.ready()] == [0]
    progress.started(0)
    assert not list(progress.ready())
    progress.done(0, START, settled(0.5))
    assert list(progress.ready()) == [(n, settled(0.5)) for n in range(1, 5)]


def test_a_failed_chunk_costs_no_other_once_the_state_is_settled() -> None:
    progress = TakeProgress(3)
    progress.done(0, START, settled(0.5))
    progress.failed(1, "killed")
    progress.done(2, settled(0.5), settled(0.5))
    assert progress.complete and progress.failures == {1: "killed"}


def test_without_the_first_chunk_the_others_fail_with_its_reason() -> None:
    progress = TakeProgress(3)
    progress.started(0)
    progress.failed(0, "killed")
    assert progress.complete and set(progress.failures) == {0, 1, 2}
    assert progress.failures[2].endswith("an earlier chunk failed: killed")


def test_a_recording_without_chunks_is_complete() -> None:
    assert TakeProgress(0).complete
