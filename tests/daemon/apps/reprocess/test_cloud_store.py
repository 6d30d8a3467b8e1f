"""A Zarr store holds the clouds of a replay, bit for bit, and ``fringed.open_clouds`` reads them."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest

import fringed
from fringed import FringedError, open_clouds
from tests.daemon.apps.reprocess.takes import replayed, reprocess, write
from tests.daemon.recording import small_take

pytest.importorskip("zarr")


@pytest.fixture
def take(tmp_path: Path, images: list[small_take.Images]) -> Path:
    return write(tmp_path / "in" / "a.mcap", images, 5)


def test_the_clouds_are_those_of_a_replay(take: Path, tmp_path: Path) -> None:
    assert not reprocess([take], tmp_path / "out", kind="zarr", chunk_pairs=2).failures
    clouds = open_clouds(tmp_path / "out" / "a")
    assert len(clouds) == 5 and clouds.sequences.tolist() == [40, 41, 42, 43, 44]
    for cloud, data in zip(clouds, replayed(take)[0].values(), strict=True):
        with np.load(io.BytesIO(data)) as expected:
            for name in ("xyz", "sigma_mm", "gray"):
                np.testing.assert_array_equal(getattr(cloud, name), expected[name])
    assert clouds.of(43).sequence == clouds[3].sequence == clouds[-2].sequence == 43
    assert [cloud.sequence for cloud in clouds[1:3]] == [41, 42]
    with pytest.raises(KeyError, match="no pair has the number 7"):
        clouds.of(7)


def test_a_store_has_the_parts_that_were_asked_for(take: Path, tmp_path: Path) -> None:
    parts = ("xyz", "rgb", "normals", "interpolated")
    for asked, names in (((), set()), (parts, set(parts[1:])), (("xyz", "normals"), {"normals"})):
        totals = reprocess([take], tmp_path / "out", kind="zarr", chunk_pairs=2, parts=asked)
        assert (totals.failures, totals.computed) == ([], 5)
        files = replayed(take, parts=asked)[0].values()
        for cloud, data in zip(open_clouds(tmp_path / "out" / "a"), files, strict=True):
            with np.load(io.BytesIO(data)) as expected:
                assert set(expected) == {"xyz", "sigma_mm", "gray"} | names
                for name in (*expected, *parts):
                    if name in expected:
                        assert getattr(cloud, name).dtype == expected[name].dtype
                        np.testing.assert_array_equal(getattr(cloud, name), expected[name])
                    else:
                        assert getattr(cloud, name) is None
    with fringed.open(tmp_path / "out" / "a") as rig:
        assert [cloud.normals is not None for cloud in rig.clouds(parts=["xyz", "normals"])] == [True] * 5


def test_a_second_run_does_nothing_and_a_longer_take_all(take: Path, tmp_path: Path) -> None:
    reprocess([take], tmp_path / "out", kind="zarr", chunk_pairs=2)
    assert reprocess([take], tmp_path / "out", kind="zarr", chunk_pairs=2).computed == 0
    write(take.with_name("a_part002.mcap"), small_take.render()[1:], 2, first=50)
    assert reprocess([take], tmp_path / "out", kind="zarr", chunk_pairs=2).computed == 7
    assert open_clouds(str(tmp_path / "out" / "a" / "clouds.zarr")).sequences[-1] == 51


def test_what_is_no_store_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(FringedError, match="no store of clouds can be read there"):
        open_clouds(tmp_path)
    monkeypatch.setitem(sys.modules, "zarr", None)
    with pytest.raises(FringedError, match=r"pip install 'fringed\[clouds\]'"):
        open_clouds(tmp_path)
