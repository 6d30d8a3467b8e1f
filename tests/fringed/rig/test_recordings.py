"""``fringed.open``: recordings behind the interface of a running daemon."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest

import fringed
from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes
from daemon.apps.replay.runner import Replay
from daemon.recording.read.take_reader import TakeReader
from fringed import ArgumentError, NotLiveError, ReceivedCloud, RecordingError, Source
from tests.daemon.recording import small_take

PATH = "pipeline.settings.min_modulation"


@pytest.fixture(scope="module")
def take(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return small_take.write(tmp_path_factory.mktemp("take") / "take.mcap", small_take.render())


@pytest.fixture(scope="module")
def replayed(take: Path) -> dict[int, SavedCloud]:
    """The clouds of ``fringed replay``."""
    with TakeReader(take) as reader:
        results = Replay(reader).results()
        return {
            each.pair.sequence: SavedCloud(each.cloud.xyz, each.cloud.sigma_mm, each.cloud.gray) for each in results
        }


@pytest.fixture
def folder(replayed: dict[int, SavedCloud], tmp_path: Path) -> Path:
    for number, cloud in replayed.items():
        (tmp_path / f"cloud_{number:06d}.npz").write_bytes(cloud_bytes(cloud, "npz"))
    (tmp_path / "summary.json").write_text('{"session": "small", "device": "sim", "calibration": "sha256:1"}')
    return tmp_path


def assert_equal(clouds: Iterator[ReceivedCloud], replayed: dict[int, SavedCloud]) -> None:
    numbers = []
    for cloud in clouds:
        numbers.append(cloud.header.seq)
        expected = replayed[cloud.header.seq]
        np.testing.assert_array_equal(cloud.xyz, expected.xyz)
        np.testing.assert_array_equal(cloud.sigma, expected.sigma_mm)
        np.testing.assert_array_equal(cloud.gray, expected.gray)
    assert numbers == list(replayed)


def test_a_take_gives_the_clouds_of_its_replay(take: Path, replayed: dict[int, SavedCloud]) -> None:
    with fringed.open(take) as rig:
        assert_equal(rig.clouds(), replayed)
        status = rig.status()
        assert (status.device, status.session, status.clouds) == ("sim", "small", len(replayed))
        assert status.points == np.isfinite(replayed[max(replayed)].xyz[..., 2]).sum()


def test_a_take_gives_the_parts_that_are_named(take: Path, folder: Path) -> None:
    with TakeReader(take) as reader:
        expected = next(Replay(reader, parts=("rgb", "normals")).results()).cloud
    with fringed.open(take) as rig:
        cloud = next(rig.clouds(parts=("xyz", "rgb", "normals", "interpolated")))
        assert cloud.gray is None and cloud.interpolated is not None and not cloud.interpolated.any()
        for name in ("xyz", "rgb", "normals"):
            np.testing.assert_array_equal(getattr(cloud, name), getattr(expected, name))
    with fringed.open(folder) as rig:
        assert next(rig.clouds(parts=("xyz", "gray"))).sigma is None
        with pytest.raises(RecordingError, match=r"cloud_000040\.npz has no rgb"):
            next(rig.clouds(parts=("xyz", "rgb")))


def test_a_take_in_an_object_store_opens(take: Path) -> None:
    fsspec = pytest.importorskip("fsspec")
    pytest.importorskip("upath")
    fsspec.filesystem("memory").pipe_file("/bucket/take.mcap", take.read_bytes())
    with fringed.open("memory://bucket/take.mcap") as rig:
        assert rig.hello().session == "small"
        preview = next(rig.previews())
    assert preview.header.seq == 40


def test_a_folder_of_clouds_gives_the_same(folder: Path, replayed: dict[int, SavedCloud]) -> None:
    with fringed.open(folder) as rig:
        assert_equal(rig.clouds(), replayed)
        assert rig.hello().session == "small"
    with fringed.open(next(folder.glob("*.npz"))) as rig:
        assert len(list(rig.clouds())) == 1


def test_a_store_of_clouds_gives_the_same(tmp_path: Path, replayed: dict[int, SavedCloud]) -> None:
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(str(tmp_path / "clouds.zarr"), mode="w")
    group.attrs["fringed_clouds"] = 1
    group.create_array("sequence", data=np.array(list(replayed), np.int64))
    for name in ("xyz", "sigma_mm", "gray"):
        group.create_array(name, data=np.stack([getattr(cloud, name) for cloud in replayed.values()]))
    with fringed.open(tmp_path) as rig:
        assert_equal(rig.clouds(), replayed)


def test_a_program_for_a_running_daemon_runs_on_a_take(
    take: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)

    async def program(rig: Source) -> list[int]:
        found = []
        async with rig.clouds(topic="cloud/depth", timeout_s=5) as clouds:
            async for cloud in clouds:
                assert cloud.gray is None
                found.append(cloud.header.seq)
        return found

    with fringed.open(take) as rig:
        numbers = asyncio.run(program(rig))
        assert len(numbers) == 3
        snapshot = rig.snapshot("one")
        with np.load(snapshot.file) as archive:
            assert np.isfinite(archive["xyz"][..., 2]).sum() == snapshot.points > 0
        preview = next(rig.previews())
        assert preview.header.seq == numbers[0] and preview.left.startswith(b"\xff\xd8")
        assert rig.mode().mode == rig.mode("single").mode == "single"


def test_a_changed_setting_changes_the_next_clouds(take: Path) -> None:
    with fringed.open(take) as rig:
        clouds = rig.clouds()
        before = len(next(clouds).points)
        assert rig.set(PATH, 60.0) == 60.0 == rig.get(PATH)
        with fringed.open(take) as other:
            other.set(PATH, 60.0)
            fewer = len(next(other.clouds()).points)
            assert fewer < before
        with pytest.raises(RecordingError, match="min_modulation"):
            rig.set(PATH, "high")
        with pytest.raises(NotLiveError, match="without the setting"):
            rig.set("pairing.tolerance_us", 5)


def test_a_recording_can_begin_again(folder: Path, replayed: dict[int, SavedCloud]) -> None:
    with fringed.open(folder, repeat=True) as rig, rig.clouds() as clouds:
        assert [next(clouds).header.seq for _ in range(4)] == [*replayed, next(iter(replayed))]
    assert list(clouds) == []


def test_what_needs_devices_is_refused_by_name(folder: Path) -> None:
    with fringed.open(folder) as rig:
        methods: list[Callable[[], object]] = [
            rig.health, rig.record, rig.takes, rig.reload, rig.start, rig.stop, rig.show, lambda: rig.mode("gray"),
            rig.previews().__next__,
        ]  # fmt: skip
        for method in methods:
            with pytest.raises(NotLiveError, match=str(folder)):
                method()


def test_what_is_no_recording_is_refused_by_name(tmp_path: Path) -> None:
    (tmp_path / "text.txt").touch()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "cloud_000001.npz").write_bytes(b"nonsense")
    for place, message in (
        ("nothing.mcap", r"nothing\.mcap: there is no such file"),
        ("nothing", "there is no such file"),
        ("text.txt", "no recording that can be opened"),
        ("empty.mcap", r"empty\.mcap"),
    ):
        with pytest.raises(RecordingError, match=message):
            fringed.open(tmp_path / place)
    with pytest.raises(RecordingError, match="not a cloud"), closing(fringed.open(tmp_path)) as rig:
        next(rig.clouds())
    with pytest.raises(ArgumentError, match="place is None"):
        fringed.open(None)  # type: ignore[arg-type]
    with pytest.raises(ArgumentError, match="key is an option"):
        fringed.open(tmp_path, key="a.key")


def test_without_the_reconstruction_a_take_names_what_to_install(take: Path) -> None:
    program = "import sys; sys.modules['mcap'] = sys.modules['numba'] = None; import fringed; fringed.open(sys.argv[1])"
    done = subprocess.run([sys.executable, "-c", program, str(take)], capture_output=True, text=True, check=False)
    last = done.stderr.strip().splitlines()[-1]
    assert "RecordingError" in last and "pip install fringed-rig" in last
