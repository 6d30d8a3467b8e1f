"""Thousands of triggers with random faults: no wrong pair, every whole pair measured, nothing leaks."""

from __future__ import annotations

import pytest

from benchmarks import box_soak


@pytest.mark.slow
@pytest.mark.timeout(280)
@pytest.mark.usefixtures("make_box")
def test_random_faults_never_make_a_wrong_pair() -> None:
    result = box_soak.soak(box_soak.arguments(["--triggers", "5000", "--seed", "12", "--gone", "0.0003"]))
    print(f"\n{box_soak.describe(result)}")  # noqa: T201 - the counts are the result
    assert result.problems() == []
    assert result.triggers == 5000 and set(result.faults) == {*box_soak.RATES, "gone"}
    assert result.losses > 0 and result.clouds > 0
    # Frames that wait when a camera goes are given up: at most a room full each time.
    assert result.pairs >= result.whole - 8 * result.losses
