"""Files below a folder, without caches."""

from __future__ import annotations

from pathlib import Path

from daemon.common.files import source_files


def test_caches_are_not_entered_and_the_order_is_fixed(tmp_path: Path) -> None:
    names = ["b.py", "a/c.py", "a/py.typed", "a/b/d.py"]
    for name in (*names, "__pycache__/b.pyc", "a/__pycache__/c.nbi"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    found = [str(path.relative_to(tmp_path)) for path in source_files(tmp_path)]
    assert found == ["b.py", "a/c.py", "a/py.typed", "a/b/d.py"]
    assert list(source_files(tmp_path / "none")) == []
