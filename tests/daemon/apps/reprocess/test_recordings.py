"""Sources name each take once, as path or URL."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.apps.reprocess.locations import location, read_if_there, write_whole
from daemon.apps.reprocess.plan.recordings import recordings_of
from daemon.common.errors import DaemonError
from tests.daemon.apps.reprocess.takes import replayed, reprocess, write
from tests.daemon.recording import small_take


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("a.mcap", "a_part002.mcap", "b.mcap.partial", "day2/a.mcap", "day2/c_part003.mcap", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    return tmp_path


def names(*sources: object) -> list[str]:
    return [recording.name for recording in recordings_of(map(str, sources))]


def test_a_folder_holds_takes_at_any_depth_and_the_parts_of_one_count_once(folder: Path) -> None:
    assert names(folder) == ["a", "b", "day2/a", "day2/c"]
    assert names(folder, folder / "a.mcap") == ["a", "b", "day2/a", "day2/c"]


def test_a_pattern_and_a_file_name_takes(folder: Path) -> None:
    assert names(f"{folder}/day*/*.mcap") == ["day2/a", "day2/c"]
    assert names(folder / "a.mcap") == ["a"]
    assert names(f"file://{folder}/day2") == ["a", "c"]


def test_two_takes_of_one_name_are_refused(folder: Path) -> None:
    with pytest.raises(DaemonError, match="would both write into the folder a"):
        names(folder / "a.mcap", folder / "day2")


def test_a_source_without_takes_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(DaemonError, match=r"no \.mcap file there"):
        names(tmp_path)


def test_object_stores_serve_as_source_and_destination(images: list[small_take.Images], tmp_path: Path) -> None:
    pytest.importorskip("upath")
    take = write(tmp_path / "a.mcap", images, 5)
    store = f"memory://{tmp_path.name}"
    for name in ("in/a.mcap", "in/day2/b.mcap"):
        write_whole(location(f"{store}/{name}"), take.read_bytes())
    assert names(f"{store}/in") == names(f"{store}/in/**/*.mcap") == ["a", "day2/b"]
    out = location(f"{store}/out")
    totals = reprocess([f"{store}/in"], out, chunk_pairs=2)  # type: ignore[list-item, arg-type]
    assert not totals.failures and totals.done == 10
    for name, data in replayed(take)[0].items():
        assert read_if_there(out / "a" / name) == read_if_there(out / "day2/b" / name) == data
    again = reprocess([f"{store}/in"], out, chunk_pairs=2)  # type: ignore[list-item, arg-type]
    assert (again.done, again.computed) == (10, 0)


def test_a_store_whose_package_is_missing_names_the_remedy() -> None:
    pytest.importorskip("upath")
    with pytest.raises(DaemonError, match="nosuch://"):
        location("nosuch://bucket/takes")
