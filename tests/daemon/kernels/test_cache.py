"""The mark beside the cached kernels names what they were compiled from."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from daemon.kernels import cache


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "kernels"))
    return tmp_path / "kernels"


def test_jobs_are_kept(own_cache: Path) -> None:
    assert cache.compiled_jobs() == frozenset()
    cache.note_compiled(["a"])
    cache.note_compiled(["b", "a"])
    assert cache.compiled_jobs() == {"a", "b"}
    assert cache.folder() == own_cache


def test_kernels_of_other_sources_are_discarded(own_cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache.note_compiled(["a"])
    kernel = own_cache / "match_1234" / "file.refine-1.py311.1.nbc"
    kernel.parent.mkdir()
    kernel.write_bytes(b"x")
    assert cache.discard_outdated() == 0
    assert kernel.exists()
    monkeypatch.setattr(cache, "cache_key", lambda: "of other sources")
    assert cache.compiled_jobs() == frozenset()
    assert cache.discard_outdated() == 1
    assert not kernel.exists()


@pytest.mark.parametrize("content", ["", "[]", "{}", '{"key": 1}', '{"key": "%s", "jobs": 3}', "\x00"])
def test_a_damaged_mark_counts_as_none(own_cache: Path, content: str) -> None:
    own_cache.mkdir()
    (own_cache / cache.MARK).write_text(content.replace("%s", cache.cache_key()))
    assert cache.compiled_jobs() == frozenset()
    cache.note_compiled(["a"])
    assert json.loads((own_cache / cache.MARK).read_text())["jobs"] == ["a"]


def test_the_processors_level_is_part_of_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    native = cache.processor()
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64-v3")
    assert cache.processor() != native
    monkeypatch.setenv("NUMBA_CPU_NAME", "x86-64-v4")
    assert cache.processor()[1].startswith("x86-64-v4")
