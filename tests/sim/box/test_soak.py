"""Many triggers with random faults: no wrong pair, every whole pair measured, nothing leaks (memory: long)."""

from __future__ import annotations

import pytest

from benchmarks.system import box_soak


@pytest.mark.parametrize(
    ("triggers", "seed", "gone"),
    [(500, 208, 0.001), pytest.param(5000, 12, 0.0003, marks=pytest.mark.long)],  # seeds with every kind of fault
    ids=["short", "long"],
)
@pytest.mark.slow
@pytest.mark.timeout(280)
@pytest.mark.usefixtures("make_box")
def test_random_faults_never_make_a_wrong_pair(triggers: int, seed: int, gone: float) -> None:
    given = ["--triggers", str(triggers), "--seed", str(seed), "--gone", str(gone)]
    result = box_soak.soak(box_soak.arguments(given))
    print(f"\n{box_soak.describe(result)}")  # noqa: T201 - the counts are the result
    assert result.problems() == []
    assert result.triggers == triggers and set(result.faults) == {*box_soak.RATES, "gone"}
    assert result.losses > 0 and result.clouds > 0
    # Frames that wait when a camera goes are given up: at most a room full each time.
    assert result.pairs >= result.whole - 8 * result.losses
