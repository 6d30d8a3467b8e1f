"""The producer is compiled once and put in place whole."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from sim.gentl.build import BuildError, NoCompilerError, build


def test_it_is_compiled_once_and_nothing_else_is_left(producer: Path, tmp_path: Path) -> None:
    library = build(tmp_path)
    made = library.stat().st_mtime_ns
    assert build(tmp_path) == library
    assert library.stat().st_mtime_ns == made
    assert [path for path in tmp_path.rglob("*") if path.is_file()] == [library]
    assert library.parent.name == producer.parent.name, "the directory is named by the sources"


def test_without_a_compiler_the_message_names_the_next_step(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(NoCompilerError, match="tools/system-packages compiler"):
        build(tmp_path)


def test_the_compilers_output_is_in_the_error(producer: Path, tmp_path: Path) -> None:  # noqa: ARG001
    with pytest.raises(BuildError, match="no-such-flag"):
        build(tmp_path, extra_flags=("--no-such-flag",))
    assert list(tmp_path.rglob("*.cti")) == []


def test_the_command_prints_its_path(producer: Path) -> None:
    command = [sys.executable, "-m", "sim.gentl.build"]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=100)
    assert result.stdout.strip() == str(producer)
