"""The verdict on a pair is the same whatever pairs lie between it and the first one."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from daemon.apps.replay.independent_verdicts import IndependentVerdicts
from daemon.recording.read.take_reader import TakeReader
from pipeline.monitor.check import consistency
from pipeline.reconstruct import first_pair
from pipeline.reconstruct.reconstructor import Reconstructor

GOLDEN = Path(__file__).parents[3] / "golden" / "take.mcap"


@pytest.fixture(autouse=True)
def strict(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every pair contradicts the calibration."""
    monkeypatch.setitem(
        consistency.LIMITS, "order_cost_beside_agreement", ((-1.0, -1.0), "of the cost of unrelated phases")
    )


@pytest.fixture(scope="module")
def pairs() -> list[Any]:
    with TakeReader(GOLDEN) as take:
        return [(pair.left, pair.right) for pair in take.pairs()]


def made(policy: Any = "withhold") -> IndependentVerdicts:
    with TakeReader(GOLDEN) as take:
        return IndependentVerdicts(Reconstructor(take.calibration().calibration, take.pattern(), take.volume()), policy)


def verdicts(pairs: list[Any]) -> list[Any]:
    reconstructor = made()
    clouds = [reconstructor.reconstruct(*pair) for pair in pairs]
    return [cloud.consistency.as_mapping() for cloud in clouds if cloud.consistency is not None]


def test_pairs_in_between_do_not_matter(pairs: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    original = consistency.Observer

    def fewer(*arguments: Any, **options: Any) -> Any:
        return original(*arguments, **(options | {"patches": 24}))  # less than there are, so that chance decides

    monkeypatch.setattr(consistency, "Observer", fewer)
    first, second = pairs
    alone = verdicts([first, second])[-1]
    assert verdicts([first, first, *[second] * 4])[-1] == alone
    assert alone["verdict"] != "unknown" and "column_offset" in alone["readings"]


def test_a_pair_that_is_not_consistent_is_scanned_itself(pairs: list[Any], monkeypatch: pytest.MonkeyPatch) -> None:
    scanned: list[Reconstructor] = []
    original = first_pair.scan_columns
    monkeypatch.setattr(first_pair, "scan_columns", lambda one, *maps: scanned.append(one) or original(one, *maps))
    bad = made()
    cloud = bad.reconstruct(*pairs[0])
    assert cloud.consistency is not None and cloud.consistency.verdict == "inconsistent"
    assert len(scanned) == 2  # the first pair's, with the column correction; then the verdict's own
    assert not bad.inner.calibrated and bad.inner.scan is None  # the next one is measured like a first pair
    bad.reconstruct(*pairs[1])
    assert len(scanned) == 4


def test_the_scan_of_a_first_pair_that_is_not_refuted_is_kept(
    pairs: list[Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.undo()
    good = made()
    good.reconstruct(*pairs[0])
    kept = good.inner.scan
    monkeypatch.setattr(good.inner, "current_cost", lambda: 1.0)
    monkeypatch.setattr(good.inner, "scan_columns", lambda: None)
    cloud = good.reconstruct(*pairs[1])
    assert cloud.consistency is not None and "order_cost" not in cloud.consistency.readings  # its own scan counts
    assert good.inner.scan is kept is not None


def test_policies(pairs: list[Any]) -> None:
    assert made("withhold").reconstruct(*pairs[0]).points == 0
    assert made("warn").reconstruct(*pairs[0]).points > 0
    assert made("off").reconstruct(*pairs[0]).consistency is None
