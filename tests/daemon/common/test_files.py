"""Files below a folder, without caches; names that are given without replacing a file."""

from __future__ import annotations

import errno
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from daemon.common import files
from daemon.common.files import rename_without_replacing, source_files


@pytest.fixture(params=["rename", "link", "neither"])
def file_system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Limit what the file system can do without replacing a file."""

    def no_links(*_: Any) -> None:
        raise OSError(errno.EPERM, os.strerror(errno.EPERM))

    if request.param != "rename":
        monkeypatch.setattr(files, "_renameat2", lambda *_: errno.EINVAL)
    if request.param == "neither":
        monkeypatch.setattr(os, "link", no_links)


def test_caches_are_not_entered_and_the_order_is_fixed(tmp_path: Path) -> None:
    names = ["b.py", "a/c.py", "a/py.typed", "a/b/d.py"]
    for name in (*names, "__pycache__/b.pyc", "a/__pycache__/c.nbi"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = [str(path.relative_to(tmp_path)) for path in source_files(tmp_path)]
    assert found == ["b.py", "a/c.py", "a/py.typed", "a/b/d.py"]
    assert list(source_files(tmp_path / "none")) == []


@pytest.mark.usefixtures("file_system")
def test_a_file_gets_a_free_name(tmp_path: Path) -> None:
    path, target = tmp_path / "a.partial", tmp_path / "a"
    path.write_bytes(b"data")
    rename_without_replacing(path, target)
    assert [file.name for file in tmp_path.iterdir()] == ["a"] and target.read_bytes() == b"data"


@pytest.mark.usefixtures("file_system")
def test_a_file_that_has_the_name_is_not_replaced(tmp_path: Path) -> None:
    path, target = tmp_path / "a.partial", tmp_path / "a"
    path.write_bytes(b"data")
    target.write_bytes(b"another file")
    with pytest.raises(FileExistsError, match=f"{path}.*{target}"):
        rename_without_replacing(path, target)
    assert path.read_bytes() == b"data" and target.read_bytes() == b"another file"


@pytest.mark.usefixtures("file_system")
def test_another_error_of_a_rename_is_raised(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        rename_without_replacing(tmp_path / "none", tmp_path / "a")


@pytest.mark.usefixtures("file_system")
@pytest.mark.parametrize("file_system", ["rename", "link"], indirect=True)  # without both it is not atomic
def test_of_many_files_that_get_one_name_at_once_one_has_it_and_none_is_lost(tmp_path: Path) -> None:
    def renamed(number: int) -> bool:
        try:
            rename_without_replacing(tmp_path / f"{number}.partial", tmp_path / "a")
        except FileExistsError:
            return False
        return True

    for number in range(64):
        (tmp_path / f"{number}.partial").write_text(str(number))
    with ThreadPoolExecutor(8) as pool:
        won = [number for number, first in enumerate(pool.map(renamed, range(64))) if first]
    assert [int((tmp_path / "a").read_text())] == won
    assert sorted(int(file.read_text()) for file in tmp_path.iterdir()) == list(range(64))
