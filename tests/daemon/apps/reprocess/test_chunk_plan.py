"""A plan has the items of a replay, in its order, for every size of chunks; nothing of the images is read for it."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.apps.reprocess.plan.chunk_plan import TakePlan, plan_take
from daemon.recording.read.take_reader import TakeReader
from tests.daemon.recording import small_take, takes

FILES = {"calibration_data": small_take.CALIBRATION, "pattern": small_take.rig_files.pattern_mapping(small_take.LAYOUT)}


def recorded(path: Path, items: list[object], **options: object) -> Path:
    takes.write(path, items, **(FILES | options))
    return path


def numbers(plan: TakePlan) -> list[int]:
    return [item.sequence for chunk in plan.chunks for item in chunk.items]


def of_replay(path: Path) -> list[int]:
    with TakeReader(path) as take:
        return [pair.sequence for pair in take.pairs()]


@pytest.fixture
def irregular(tmp_path: Path) -> Path:
    """Unpaired frames, a gap, a partner that comes late, compression, and a second part."""
    items = [takes.pair(n) for n in range(5)] + [takes.unpaired("left", 7), takes.unpaired("right", 9)]
    items += [takes.pair(n) for n in range(10, 30)]
    late = takes.pair(31)
    items += [takes.unpaired("left", 31), *(takes.pair(n) for n in range(40, 43)), type(items[5])(late.right)]
    return recorded(tmp_path / "take.mcap", [*items, takes.pair(50)], max_part_bytes=60_000)


@pytest.mark.parametrize("chunk_pairs", [1, 2, 3, 7, 1000])
def test_a_plan_has_the_pairs_of_a_replay_in_their_order(irregular: Path, chunk_pairs: int) -> None:
    plan = plan_take(irregular, chunk_pairs=chunk_pairs)
    assert numbers(plan) == of_replay(irregular)
    assert plan.pairs == plan.items == len(numbers(plan)) > 20
    assert max(len(chunk.items) for chunk in plan.chunks) <= 2 * chunk_pairs
    assert len({chunk.name for chunk in plan.chunks}) == len(plan.chunks)


@pytest.mark.parametrize("compression", ["none", "zstd"])
def test_heads_of_compressed_chunks_are_the_same(tmp_path: Path, compression: str) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in range(6)], compression=compression)
    plan = plan_take(take, chunk_pairs=2)
    assert numbers(plan) == of_replay(take) == list(range(6))
    assert plan.chunks[0].items[0].t_ns == takes.pair(0).left.t_exposure_ns


def test_the_first_pair_of_several_chunks_is_a_chunk_of_its_own(tmp_path: Path) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in range(10)])
    assert [len(chunk.items) for chunk in plan_take(take, chunk_pairs=4).chunks] == [1, 3, 4, 2]
    assert [len(chunk.items) for chunk in plan_take(take, chunk_pairs=10).chunks] == [10]


def test_an_excluded_frame_changes_its_own_chunk_only(tmp_path: Path) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in range(12)])
    plan = plan_take(take, chunk_pairs=3)
    without = plan_take(take, chunk_pairs=3, excluded=[plan.chunks[2].items[1].lefts[0]])
    assert numbers(without) == [n for n in numbers(plan) if n != plan.chunks[2].items[1].sequence]
    assert without.unpaired == {"right": 1}
    same = [a == b for a, b in zip(plan.chunks, without.chunks, strict=True)]
    assert same == [True, True, False, True, True]


def test_only_the_last_pair_of_a_repeated_number_writes_a_file(tmp_path: Path) -> None:
    items = [takes.pair(n) for n in (0, 1, 2)]
    take = recorded(tmp_path / "a.mcap", items)
    recorded(tmp_path / "a_part002.mcap", [takes.pair(n) for n in (1, 2, 3)])
    plan = plan_take(take, chunk_pairs=2)
    found = [(item.sequence, item.write) for chunk in plan.chunks for item in chunk.items]
    assert found == [(0, True), (1, False), (2, False), (1, True), (2, True), (3, True)]


def test_with_a_temporal_prior_chunks_end_only_where_no_pair_can_use_the_one_before(tmp_path: Path) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in (*range(5), *range(100, 103), 200)])
    plan = plan_take(take, chunk_pairs=1, use_prior=True)
    assert [len(chunk.items) for chunk in plan.chunks] == [5, 3, 1]


def test_with_temporal_fusion_a_take_is_one_chunk(tmp_path: Path) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in (*range(5), 200)])
    assert [len(chunk.items) for chunk in plan_take(take, chunk_pairs=1, fuse=True).chunks] == [6]


def test_no_image_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    take = recorded(tmp_path / "a.mcap", [takes.pair(n) for n in range(4)])
    monkeypatch.setattr("daemon.recording.format.mcap_chunks.load", lambda *_: pytest.fail("a chunk was loaded"))
    assert numbers(plan_take(take, chunk_pairs=2)) == [0, 1, 2, 3]
