"""Results are bit for bit those of a replay, however the recording is divided, damaged or recorded."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
import yaml

from daemon.apps.reprocess.carried_state import CarriedState, capture, restore
from daemon.apps.reprocess.engine.tasks import InlineEngine
from daemon.recording.read.take_reader import TakeReader
from pipeline.common.errors import ImageError
from pipeline.common.settings import Settings
from pipeline.monitor.check import consistency
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig import rig_files
from tests.daemon.apps.reprocess.takes import files_of, replayed, reprocess, write
from tests.daemon.recording import small_take

Images = list[small_take.Images]
ALL_PARTS = "xyz", "gray", "sigma", "rgb", "normals", "interpolated"
GOLDEN = Path(__file__).parents[3] / "golden" / "take.mcap"


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory, images: Images) -> Path:
    return write(tmp_path_factory.mktemp("takes") / "part7.mcap", images, 11)


@pytest.fixture(scope="module")
def of_a_replay(take: Path) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """The clouds and verdicts of a replay of the take."""
    return replayed(take)


def verdicts_in(folder: Path) -> list[dict[str, object]]:
    rows = json.loads((folder / "summary.json").read_text())["per_pair"]
    return [{"sequence": row["sequence"], "consistency": row["consistency"]} for row in rows]


@pytest.mark.parametrize("chunk_pairs", [1, pytest.param(2, marks=pytest.mark.long), 5, 100])
def test_clouds_and_verdicts_are_those_of_a_replay(
    take: Path, of_a_replay: tuple[dict[str, bytes], list[dict[str, Any]]], tmp_path: Path, chunk_pairs: int
) -> None:
    files, verdicts = of_a_replay
    totals = reprocess([take], tmp_path, chunk_pairs=chunk_pairs)
    assert not totals.failures
    assert files_of(tmp_path / "part7") == files
    assert len(files) == 11
    assert verdicts_in(tmp_path / "part7") == verdicts
    assert (totals.done, totals.computed, totals.items) == (11, 11, 11)


@pytest.mark.parametrize("chunk_pairs", [pytest.param(1, marks=pytest.mark.long), 3])
@pytest.mark.parametrize("verdict", ["consistent", "inconsistent"])
def test_verdicts_of_large_images_depend_on_the_first_pair_only(
    tmp_path: Path, chunk_pairs: int, verdict: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if verdict == "inconsistent":
        monkeypatch.setitem(
            consistency.LIMITS, "order_cost_beside_agreement", ((-1.0, -1.0), "of the cost of unrelated phases")
        )
    for name in ("a.mcap", "a_part002.mcap", "a_part003.mcap"):
        shutil.copy(GOLDEN, tmp_path / name)
    files, verdicts = replayed(tmp_path / "a.mcap")
    reprocess([tmp_path / "a.mcap"], tmp_path / "out", chunk_pairs=chunk_pairs)
    assert [row["consistency"]["verdict"] for row in verdicts] == [verdict] * 6
    assert verdicts_in(tmp_path / "out" / "a") == verdicts
    assert files_of(tmp_path / "out" / "a") == files
    manifests = (tmp_path / "out" / "a" / "chunks").glob("*.json")
    scans = [json.loads(path.read_text())["after"]["scan"] for path in manifests]
    # A refuted first pair is not kept: the next one is measured like it.
    assert scans and all((scan is not None) == (verdict == "consistent") for scan in scans)


@pytest.mark.parametrize("chunk_pairs", [1, 100])
def test_so_they_are_with_a_temporal_prior(images: Images, tmp_path: Path, chunk_pairs: int) -> None:
    take = write(tmp_path / "a.mcap", images[:1], 4)
    write(tmp_path / "a_part002.mcap", images[1:2], 3, first=100)
    files, _ = replayed(take, use_prior=True)
    reprocess([take], tmp_path / "out", chunk_pairs=chunk_pairs, use_prior=True)
    assert files_of(tmp_path / "out" / "a") == files
    assert len(files) == 7
    assert len(list((tmp_path / "out" / "a" / "chunks").iterdir())) == 2


def test_so_they_are_with_temporal_fusion(images: Images, tmp_path: Path) -> None:
    takes = [
        write(tmp_path / f"{name}.mcap", small_take.at_rest(images[n], 4), 4)
        for n, name in enumerate(("first", "second"))
    ]
    reprocess(takes, tmp_path / "out", engine=InlineEngine(), chunk_pairs=1, fuse=True)
    for take in takes:
        files, verdicts = replayed(take, fuse=True)
        assert files != replayed(take)[0]
        assert files_of(tmp_path / "out" / take.stem) == files
        assert verdicts_in(tmp_path / "out" / take.stem) == verdicts
    assert reprocess(takes, tmp_path / "out", fuse=True).computed == 0
    assert reprocess(takes, tmp_path / "out").computed == 8


def test_other_settings_reach_the_workers(take: Path, tmp_path: Path) -> None:
    settings = Settings(min_modulation=30.0, self_calibrate=False)
    files, _ = replayed(take, settings=settings)
    reprocess([take], tmp_path, settings=settings, chunk_pairs=3)
    assert files_of(tmp_path / "part7") == files


@pytest.mark.parametrize(
    ("kind", "parts"),
    [
        pytest.param(kind, parts, marks=[pytest.mark.long] * (kind != "npz" and parts != ALL_PARTS))
        for kind in ("npz", "ply", "pcd")
        for parts in ((), ("xyz",), ALL_PARTS)
    ],
)
def test_files_have_the_parts_of_a_replay(images: Images, tmp_path: Path, kind: str, parts: tuple[str, ...]) -> None:
    """With filled holes, which a file marks."""
    options = {"kind": kind, "parts": parts, "settings": Settings(hole_filling_size=8)}
    take = write(tmp_path / "a.mcap", images, 3)
    files, _ = replayed(take, **options)
    assert not reprocess([take], tmp_path / "out", chunk_pairs=2, **options).failures
    assert files_of(tmp_path / "out" / "a") == files
    assert len(files) == 3


def test_a_truncated_take_gives_what_a_replay_of_it_gives_and_is_reported(take: Path, tmp_path: Path) -> None:
    cut = tmp_path / "in" / "cut.mcap"
    cut.parent.mkdir()
    data = take.read_bytes()
    cut.write_bytes(data[: int(len(data) * 0.6)])
    write_other = tmp_path / "in" / "whole.mcap"
    write_other.write_bytes(data)
    files, _ = replayed(cut)
    totals = reprocess([tmp_path / "in"], tmp_path / "out", chunk_pairs=2)
    assert files_of(tmp_path / "out" / "cut") == files
    assert 3 < len(files) < 11
    assert len(files_of(tmp_path / "out" / "whole")) == 11
    assert any("cut off" in problem for problem in totals.closed[0].problems)
    assert not totals.failures


@pytest.mark.parametrize("chunk_pairs", [2, 100])
def test_damaged_images_are_left_out_as_in_a_replay(take: Path, tmp_path: Path, chunk_pairs: int) -> None:
    data = bytearray(take.read_bytes())
    for share in (0.35, 0.62):
        at = int(len(data) * share)
        data[at : at + 64] = bytes(64)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    files, verdicts = replayed(damaged)
    totals = reprocess([damaged], tmp_path / "out", chunk_pairs=chunk_pairs)
    assert 8 <= len(files) < 11
    assert files_of(tmp_path / "out" / "damaged") == files
    assert verdicts_in(tmp_path / "out" / "damaged") == verdicts
    assert totals.closed[0].damaged >= 2
    assert (
        any("damaged at byte" in problem for problem in totals.closed[0].problems)
        or json.loads((tmp_path / "out" / "damaged" / "summary.json").read_text())["problems"]
    )


def test_a_pair_that_the_pipeline_rejects_is_listed_and_the_rest_is_done(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    original = Reconstructor.orders

    def refusing(self: Reconstructor, left: Any, *arguments: Any, **options: Any) -> Any:
        if left.sum() == refused:
            raise ImageError("refused")
        return original(self, left, *arguments, **options)

    with TakeReader(take) as reader:
        refused = next(reader.pairs()).left.sum()
    monkeypatch.setattr(Reconstructor, "orders", refusing)
    files, _ = replayed(take)
    totals = reprocess([take], tmp_path, chunk_pairs=3)
    assert files_of(tmp_path / "part7") == files
    assert totals.sums.failed == 4 and totals.sums.clouds == len(files) == 7
    failed = json.loads((tmp_path / "part7" / "summary.json").read_text())["failed"]
    assert failed[0] == {"sequence": 40, "error": "refused"}


def test_a_calibration_of_another_size_fails_with_the_reason_and_costs_no_other_recording(
    images: Images, tmp_path: Path
) -> None:
    layout = small_take.RigLayout().scaled(0.25)
    other = yaml.safe_dump(rig_files.calibration_mapping(layout, small_take.OPTICS), sort_keys=False).encode()
    write(tmp_path / "in" / "bad.mcap", images, 3, calibration_data=other)
    write(tmp_path / "in" / "good.mcap", images, 3)
    (tmp_path / "in" / "foreign.mcap").write_bytes(b"no take at all")
    totals = reprocess([tmp_path / "in"], tmp_path / "out", chunk_pairs=2)
    assert len(files_of(tmp_path / "out" / "good")) == 3
    assert not (tmp_path / "out" / "bad" / "summary.json").exists()
    reasons = "\n".join(totals.failures)
    assert "bad: pairs 40 to 40: cameras.left.size is [256, 205]" in reasons
    assert "foreign: " in reasons and "not an MCAP file" in reasons


def test_a_state_survives_json_and_restores_a_reconstructor() -> None:
    from daemon.apps.replay.reconstruct_item import warmed_reconstructor

    layout = small_take.LAYOUT
    arguments = layout.calibration_for(small_take.OPTICS), layout.pattern(), layout.volume()
    made = warmed_reconstructor(*arguments, encoding="rgb8", settings=Settings())
    first = capture(made)
    assert not first.settled
    values = (0.1 + 0.2, -1e-17, 1 / 3, 1.1, 0.9, 1.0, 2 / 3, 0.7, 0.01, -0.02, 1 / 30, 0.0, -1e-18, 0.1,
              1.0, 0.1, -0.1, 1 / 7, 0.0, 0.2, -0.3, 0.5)  # fmt: skip
    scan = (0.25, 0.1, 0.25, 0.1, 0.3, -3.0, 0.1, 0.2, 0.11, 0.32, 1 / 7)
    state = CarriedState("rgb8", ((values, True),), scan, (0.25, 1 / 3), 0.7)
    assert state.settled
    assert CarriedState.from_json(json.loads(json.dumps(state.as_json()))) == state
    for name in state.as_json():  # a manifest of an earlier program is not continued
        with pytest.raises(KeyError, match=name):
            CarriedState.from_json({key: value for key, value in state.as_json().items() if key != name})
    with pytest.raises(ValueError, match="scan has 7 numbers, expected 11"):
        CarriedState.from_json(state.as_json() | {"scan": list(scan[:7])})
    shorter = state.as_json() | {"corrections": [[list(values[:14]), True]]}
    with pytest.raises(ValueError, match="corrections have 14 numbers, expected 3 or 22"):
        CarriedState.from_json(shorter)
    restore(made, state)
    assert capture(made) == state
    restore(made, first)
    assert dataclasses.astuple(capture(made)) == dataclasses.astuple(first)
