"""The command line: fast start, one-sentence errors, exit codes."""

from __future__ import annotations

import subprocess
import sys

import pytest

from daemon.cli import entry
from daemon.cli.command_table import COMMANDS
from daemon.common.errors import ConfigError


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
    process = python("import sys; from daemon.cli.entry import run; sys.exit(run(['mesure']))")
    assert process.returncode == 2 and "No such command 'mesure'" in process.stderr


def test_an_expected_error_is_one_sentence_and_exit_code_1(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(arguments: list[str]) -> int:
        raise ConfigError([f"rig.yaml:1:1: no good {arguments}"])

    monkeypatch.setattr("daemon.cli.command_table.invoke", fail)
    monkeypatch.delenv("FRINGED_DEBUG", raising=False)
    assert entry.run(["run"]) == 1
    assert capsys.readouterr().err == "fringed: rig.yaml:1:1: no good ['run']\n"
    with pytest.raises(ConfigError):
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
    assert process.returncode == 1
    assert "pip install 'fringed[rig]'" in process.stderr and "Traceback" not in process.stderr
