"""Commands that set projectors up: run in order, bounded in time, their failures reported."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.projector import open_external
from drivers.projector.hooks import run_hooks

BLACK = np.zeros((4, 6, 3), np.uint8)


def note(word: str) -> list[str]:
    """A command that appends a word, and the name of the output, to the file ``said`` in its directory."""
    code = f"import os; open('log', 'a').write('{word} ' + os.environ['FRINGED_OUTPUT'] + ';')"
    return [sys.executable, "-c", code]


def run(*commands: list[str], directory: Path, timeout_s: float = 30.0) -> None:
    run_hooks(tuple(map(tuple, commands)), timeout_s=timeout_s, directory=directory, variables={})


def test_hooks_run_at_open_show_and_close_where_the_rig_stands(tmp_path: Path) -> None:
    hook = {"open": [note("a"), note("b")], "show": [note("c")], "close": [note("d")]}
    projector = open_external({"size": [6, 4], "name": "lc", "hook": hook}, tmp_path)
    assert projector.open().size == (6, 4)
    projector.open()
    projector.show(BLACK)
    projector.show(BLACK)
    assert projector.problem() == ""
    projector.close()
    projector.close()
    assert (tmp_path / "log").read_text() == "a lc;b lc;c lc;c lc;d lc;"


def test_nothing_is_taken_for_a_shell_line(tmp_path: Path) -> None:
    run([sys.executable, "-c", "import sys; open('arguments', 'w').write(repr(sys.argv[1:]))", "$HOME; *", ""],
        directory=tmp_path)  # fmt: skip
    assert (tmp_path / "arguments").read_text() == "['$HOME; *', '']"


def test_a_failing_command_is_reported_with_its_output_and_the_next_is_not_run(tmp_path: Path) -> None:
    fails = [sys.executable, "-c", "import sys; print('lamp is cold'); sys.exit(3)"]
    with pytest.raises(DriverError, match="ended with 3: lamp is cold"):
        run(fails, note("never"), directory=tmp_path)
    assert not (tmp_path / "log").exists()


def test_a_command_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DriverError, match=r"no-such-program.*cannot be started"):
        run(["no-such-program"], directory=tmp_path)


def test_a_command_that_takes_too_long_is_killed_with_all_it_started(tmp_path: Path) -> None:
    code = "import subprocess, sys; subprocess.run([sys.executable, '-c', 'import time; time.sleep(600)'])"
    with pytest.raises(DriverError, match=r"did not end within 0.5 s"):
        run([sys.executable, "-c", code], directory=tmp_path, timeout_s=0.5)


def test_a_hook_that_fails_while_showing_is_a_problem_and_while_opening_an_error(tmp_path: Path) -> None:
    options: dict[str, Any] = {"size": [6, 4], "hook": {"show": [["false"]]}}
    projector = open_external(options, tmp_path)
    projector.open()
    projector.show(BLACK)
    assert "'false' ended with 1" in projector.problem()
    projector.close()
    with pytest.raises(DriverError, match="ended with 1"):
        open_external({**options, "hook": {"open": [["false"]]}}, tmp_path).open()


def test_an_external_projector_takes_images_of_its_size_only(tmp_path: Path) -> None:
    projector = open_external({"size": [6, 4]}, tmp_path)
    with pytest.raises(DriverError, match="open"):
        projector.show(BLACK)
    projector.open()
    with pytest.raises(SettingRefused, match=r"expected \(4, 6, 3\)"):
        projector.show(BLACK.transpose(1, 0, 2))
