"""The campaign: every kind of fault equally often, and every problem reported."""

from __future__ import annotations

import random
import shutil
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from benchmarks.campaign.__main__ import order_of
from benchmarks.campaign.faults import FAULTS
from benchmarks.campaign.report import Campaign, Outcome
from benchmarks.campaign.takes import Takes, first_part, stem_of
from benchmarks.load.__main__ import percentile, verdict
from daemon.recording.read.take_reader import TakeReader
from drivers.protocols import SIDES
from sim.box.exposure_ledger import Ledger, Trigger, digest
from sim.devices.faults import FaultKind

TAKE = Path(__file__).parents[1] / "golden" / "take.mcap"


@pytest.mark.parametrize("count", [1, 40, 504])
def test_every_kind_occurs_equally_often(count: int) -> None:
    order = Counter(fault.name for fault in order_of(count, random.Random(7)))
    assert sum(order.values()) == count
    assert max(order.values()) - min(order.values() if len(order) == len(FAULTS) else [0]) <= 1


def test_every_problem_is_reported() -> None:
    campaign = Campaign(outcomes=[Outcome("disk full", True, 0, 0.2), Outcome("daemon killed", False, 90, None)])
    campaign.takes.wrong, campaign.takes.unreadable = 1, 2
    campaign.missing_s = [0.1, 3.5]
    text = "\n".join(campaign.problems())
    assert all(word in text for word in ("daemon killed", "1 wrong", "2 takes", "3.5 s"))
    assert "| daemon killed | 1 | 0 | 90 / 90 | never |" in campaign.markdown()
    assert not Campaign(outcomes=[Outcome("disk full", True, 0, 0.2)]).problems()


@pytest.mark.parametrize(
    ("name", "stem"),
    [("a_1.mcap", "a_1"), ("a_1_part002.mcap", "a_1"), ("a_1.mcap.partial", "a_1"), ("a_part003.mcap.partial", "a")],
)
def test_all_files_of_a_take_have_one_stem(name: str, stem: str) -> None:
    assert stem_of(Path(name)) == stem


def ledger_of(path: Path, *, swapped: bool) -> Ledger:
    """What a world would have shown for a take; swapped: the right images of the first two triggers."""
    with TakeReader(path) as reader:
        pairs = list(reader.pairs())
    rights = [pair.right for pair in pairs]
    if swapped:
        rights[0], rights[1] = rights[1], rights[0]
    ledger = Ledger()
    for index, (pair, right) in enumerate(zip(pairs, rights, strict=True)):
        exposures = {"left": digest(np.asarray(pair.left)), "right": digest(np.asarray(right))}
        ledger.note(Trigger(index, index, b"", False, 0, dict.fromkeys(SIDES, FaultKind.NONE), exposures))
    return ledger


@pytest.mark.parametrize("swapped", [False, True])
def test_a_take_with_a_wrong_pair_is_reported_and_each_is_read_once(tmp_path: Path, swapped: bool) -> None:
    ledger = ledger_of(TAKE, swapped=swapped)
    for name in ("x.mcap", "writing.mcap.partial"):
        shutil.copy(TAKE, tmp_path / name)
    (tmp_path / "no.mcap").write_bytes(b"garbage")
    takes = Takes()
    takes.read(tmp_path, ledger, writing="writing")
    assert (takes.wrong, takes.unreadable, takes.takes) == (2 if swapped else 0, 1, 2)
    assert (takes.right, takes.unknown) == (0 if swapped else 2, 0)
    assert [file.name for file in tmp_path.iterdir()] == ["writing.mcap.partial"]
    assert first_part(tmp_path, "writing").exists()


def test_a_tenth_is_the_limit_of_the_effect_of_load() -> None:
    alone = {"rate_hz": 10.0, "p50_ms": 30.0, "p99_ms": 40.0}
    assert verdict({"alone": alone, "loaded": {"rate_hz": 9.5, "p50_ms": 60.0, "p99_ms": 43.0}}) == []
    assert len(verdict({"alone": alone, "loaded": {"rate_hz": 8.5, "p50_ms": 30.0, "p99_ms": 45.0}})) == 2
    assert percentile([float(k) for k in range(100)], 0.99) == 99.0
