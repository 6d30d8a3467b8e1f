"""Archives of kernels come back whole, and nothing but what suits this installation is unpacked."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daemon.kernels import archive, cache
from daemon.kernels.archive import ArchiveError, pack, read_description, unpack

KERNEL = b"compiled" * 100


@pytest.fixture
def packed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The description of an archive with one kernel."""
    cached = tmp_path / "cached"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(cached))
    kernel = cached / archive._folders()["pipeline/match"] / "subpixel_match.match-1.py311.1.nbc"
    kernel.parent.mkdir(parents=True)
    kernel.write_bytes(KERNEL)
    (kernel.parent / "other.txt").write_text("no kernel")
    cache.note_compiled(["a"])
    return pack(cached, tmp_path / "release", "x86-64-v3")


def test_an_archive_comes_back(packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert unpack(packed, tmp_path / "here") == 2
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "here"))
    assert cache.compiled_jobs() == {"a"}
    (kernel,) = (tmp_path / "here").rglob("*.nb*")
    assert kernel.read_bytes() == KERNEL
    assert {path.name for path in packed.parent.iterdir()} == {packed.name, packed.with_suffix(".tar.xz").name}


@pytest.mark.parametrize("name", ["python", "numba", "llvmlite", "numpy"])
def test_another_version_is_named(packed: Path, tmp_path: Path, name: str) -> None:
    values = json.loads(packed.read_text())
    values["libraries"][name] = "0.1"
    packed.write_text(json.dumps(values))
    with pytest.raises(ArchiveError, match=f"compiled with {name} 0.1, here is "):
        unpack(packed, tmp_path / "here")
    assert not (tmp_path / "here").exists()


def test_other_sources_and_another_processor_are_named(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(cache, "cache_key", lambda: "of another processor")
    with pytest.raises(ArchiveError, match="compiled for x86-64-v3"):
        unpack(packed, tmp_path / "here")
    monkeypatch.setattr(cache, "sources_key", lambda: "of other sources")
    with pytest.raises(ArchiveError, match="other sources"):
        unpack(packed, tmp_path / "here")


@pytest.mark.parametrize("damage", [lambda data: data[:-20], lambda data: b"\0" + data[1:], lambda _: b""])
def test_a_damaged_archive_leaves_nothing(packed: Path, tmp_path: Path, damage: object) -> None:
    file = packed.with_suffix(".tar.xz")
    file.write_bytes(damage(file.read_bytes()))  # type: ignore[operator]
    with pytest.raises(ArchiveError, match="is damaged"):
        unpack(packed, tmp_path / "here")
    assert not (tmp_path / "here").exists() and not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"level": 1}'])
def test_a_damaged_description_is_an_error(packed: Path, text: str) -> None:
    packed.write_text(text)
    with pytest.raises(ArchiveError, match="cannot be read"):
        read_description(packed)


def test_files_that_are_no_kernels_are_refused(packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(archive, "_folders", lambda: {"pipeline/decode": "decode"})
    with pytest.raises(ArchiveError, match=r"'pipeline/match/subpixel.*is no compiled kernel of this project"):
        unpack(packed, tmp_path / "here")


def test_what_another_process_unpacked_meanwhile_is_kept(packed: Path, tmp_path: Path) -> None:
    here = tmp_path / "here"
    here.mkdir()
    (here / cache.MARK).write_text("of the other")
    unpack(packed, here)
    assert (here / cache.MARK).read_text() == "of the other"
    assert not list(tmp_path.glob(".*"))


def test_folders_that_numba_made_at_the_import_are_replaced(packed: Path, tmp_path: Path) -> None:
    (tmp_path / "here/match_1234").mkdir(parents=True)
    unpack(packed, tmp_path / "here")
    assert not (tmp_path / "here/match_1234").exists() and (tmp_path / "here" / cache.MARK).is_file()
    assert not list(tmp_path.glob(".*"))
