"""Sets of pairs: with lost, doubled or late pairs, a set holds each image once, all of one pass, in order."""

from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.set_assembler import MAX_GAP_NS, SetAssembler
from daemon.live.items import Pair
from drivers.protocols import SIDES, TRIGGER_MODULUS, Frame

MS = 1_000_000
Exposure = tuple[int, int]
"""How many triggers after the first image's, and start of exposure."""


def fed(assembler: SetAssembler[Exposure], exposures: list[Exposure], first: int) -> list[tuple[Exposure, ...]]:
    made = (
        assembler.feed((first + position) % TRIGGER_MODULUS, t_ns, (position, t_ns)) for position, t_ns in exposures
    )
    return [one for one in made if one is not None]


def at(position: int) -> Exposure:
    return position, (position + 10_000) * 33 * MS


@settings(max_examples=300, deadline=None)
@given(
    frames=st.integers(1, 13),
    first=st.integers(0, TRIGGER_MODULUS - 1),
    start=st.integers(-40, 40),
    kept=st.lists(st.booleans(), min_size=1, max_size=120),
    twice=st.sets(st.integers(0, 119)),
)
def test_a_set_is_made_of_each_pass_that_lost_nothing_and_of_no_other(
    frames: int, first: int, start: int, kept: list[bool], twice: set[int]
) -> None:
    positions = [start + i for i, keep in enumerate(kept) if keep for _ in range(1 + (i in twice))]
    assembler: SetAssembler[Exposure] = SetAssembler(frames, first)
    made = fed(assembler, [at(position) for position in positions], first)
    whole = [
        k for k in range(start // frames - 1, (start + len(kept)) // frames + 1)
        if all(k * frames + i in positions for i in range(frames))
    ]  # fmt: skip
    assert [[position for position, _ in one] for one in made] == [
        list(range(k * frames, (k + 1) * frames)) for k in whole
    ]
    assembler.flush()
    touched = {position // frames for position in positions}
    assert (assembler.complete, assembler.incomplete) == (len(whole), len(touched) - len(whole))


@settings(max_examples=300, deadline=None)
@given(
    frames=st.integers(2, 9),
    first=st.integers(0, TRIGGER_MODULUS - 1),
    exposures=st.lists(st.tuples(st.integers(-30, 30), st.integers(0, 200 * MAX_GAP_NS // 100)), max_size=150),
)
def test_whatever_comes_no_set_mixes_passes_and_no_pair_is_used_twice(
    frames: int, first: int, exposures: list[Exposure]
) -> None:
    assembler: SetAssembler[int] = SetAssembler(frames, first)
    answers = [
        assembler.feed((first + position) % TRIGGER_MODULUS, t_ns, number)
        for number, (position, t_ns) in enumerate(exposures)
    ]
    made = [one for one in answers if one is not None]
    for one in made:
        positions, times_ns = zip(*(exposures[number] for number in one), strict=True)
        assert positions[0] % frames == 0 and list(positions) == list(range(positions[0], positions[0] + frames))
        assert all(0 < b - a <= MAX_GAP_NS for a, b in itertools.pairwise(times_ns))
    used = [number for one in made for number in one]
    assert len(used) == len(set(used))


def test_a_pair_that_is_a_little_late_still_joins_its_set() -> None:
    assembler: SetAssembler[Exposure] = SetAssembler(3)
    assert [p for p, _ in fed(assembler, [at(n) for n in (0, 2, 3, 1)], 0)[0]] == [0, 1, 2]
    assert assembler.incomplete == 0


def test_images_of_two_times_under_one_number_spoil_the_set() -> None:
    assembler: SetAssembler[Exposure] = SetAssembler(2)
    assert fed(assembler, [(0, 5 * MS), (0, 900 * MS), (1, 910 * MS)], 0) == []
    assert assembler.incomplete == 1


def test_a_restarted_count_is_assembled_from_its_new_start() -> None:
    assembler: SetAssembler[Exposure] = SetAssembler(3)
    late = [(n, (5000 + n) * 33 * MS) for n in range(3)]
    made = fed(assembler, [*(at(n) for n in range(300, 304)), *late], 0)
    assert [one[0][0] for one in made] == [300, 0]
    assert assembler.restarts == 1


def test_numbers_may_wrap_within_a_set() -> None:
    first = TRIGGER_MODULUS - 2
    assembler: SetAssembler[Exposure] = SetAssembler(4, first)
    assert len(fed(assembler, [at(n) for n in range(8)], first)) == 2


def test_cameras_that_restart_their_count_are_detected_although_the_numbers_go_on() -> None:
    pairer, numbers, t_ns = Pairer(), [], 0
    for number in (*range(500, 508), *range(3, 12)):
        t_ns += 33 * MS
        for side in SIDES:
            frame = Frame(side, number, t_ns, t_ns + 10 * MS, "mono8", np.zeros((1, 1), np.uint8))
            numbers += [event.seq for event in pairer.feed(frame) if isinstance(event, Pair)]
    assert pairer.counter_restarts == 1
    assert len(numbers) > 12 and numbers == sorted(set(numbers))
