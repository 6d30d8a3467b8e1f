"""The command line: fast start, one-sentence errors, exit codes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from daemon.cli import entry
from daemon.cli.command_table import COMMANDS
from daemon.common.errors import ConfigError, DaemonError, InputError
from fringed.errors import NoDaemonError


def python(code: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


def test_the_help_imports_nothing_heavy_and_names_every_command() -> None:
    process = python(
        "import sys; from daemon.cli.entry import run; code = run(['--help'])\n"
        "print(code, sorted({'numpy', 'cv2', 'numba', 'zmq', 'pydantic', 'rerun'} & set(sys.modules)))"
    )
    assert process.stdout.splitlines()[-1] == "0 []", process.stderr
    assert all(f"  {name} " in process.stdout for name in COMMANDS)


def test_an_unknown_command_is_a_usage_error() -> None:
    process = python("import sys; from daemon.cli.entry import run; sys.exit(run(['staus']))")
    assert process.returncode == 2
    assert process.stderr == "fringed: there is no command 'staus'; did you mean 'status'?; see `fringed -h`\n"


@pytest.mark.parametrize("line", [[], ["calibrate"]])
def test_a_group_without_a_command_prints_its_help(line: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert entry.run(line) == 2
    help_ = capsys.readouterr().err
    assert help_.startswith(" ".join(["Usage: fringed", *line, "[OPTIONS] COMMAND"])) and help_.count("\n") > 10


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_short_option_for_help(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert entry.run([name, "-h"]) == 0
    assert f"Usage: fringed {name} " in capsys.readouterr().out


@pytest.mark.parametrize(
    ("error", "status", "sentence"),
    [
        (ConfigError(["rig.yaml:1:1: no good"]), 2, "rig.yaml:1:1: no good"),
        (InputError("--near 5 mm must be smaller"), 2, "--near 5 mm must be smaller"),
        (NoDaemonError("no daemon answers at x"), 2, "no daemon answers at x"),
        (FileNotFoundError(2, "No such file or directory", "nope.yaml"), 2, "nope.yaml: no such file or directory"),
        (OSError(28, "No space left on device", "takes"), 1, "takes: no space left on device"),
        (DaemonError("the disk is full"), 1, "the disk is full"),
    ],
)
def test_an_expected_error_is_one_sentence_and_2_if_the_input_is_wrong(
    error: Exception, status: int, sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: list[str]) -> int:
        raise error

    monkeypatch.setattr("daemon.cli.command_table.invoke", fail)
    monkeypatch.delenv("FRINGED_DEBUG", raising=False)
    assert entry.run(["run"]) == status
    assert capsys.readouterr().err == f"fringed: {sentence}\n"
    with pytest.raises(type(error)):
        entry.run(["run", "--debug"])


def test_an_unexpected_error_is_not_caught(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(arguments: list[str]) -> int:
        raise KeyError(arguments[0])

    monkeypatch.setattr("daemon.cli.command_table.invoke", fail)
    with pytest.raises(KeyError):
        entry.run(["run"])


def test_without_the_packages_of_a_rig_the_installation_is_described() -> None:
    process = python(
        "import sys; sys.modules['typer'] = None; from daemon.cli.entry import run; sys.exit(run(['--help']))"
    )
    assert process.returncode == 2
    assert "pip install fringed-rig" in process.stderr and "Traceback" not in process.stderr


def test_a_command_ends_without_a_garbage_collection() -> None:
    """The compiler's objects took half a second of processor time."""
    process = python(
        "import atexit, gc, sys; from daemon.cli import entry; sys.argv = ['fringed', '--version']\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 0)); entry.main()"
    )
    assert process.returncode == 0 and process.stdout.splitlines()[-1] == "True", process.stderr
