"""``python -m fringed`` and the version."""

from __future__ import annotations

import subprocess
import sys
from importlib.metadata import version

import pytest

import fringed


def module(*arguments: str, before: str = "") -> subprocess.CompletedProcess[str]:
    code = f"import sys, runpy\n{before}\nsys.argv = ['x', *{list(arguments)!r}]\n"
    code += "runpy.run_module('fringed', run_name='__main__')"
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)


def test_the_version_is_that_of_the_distribution() -> None:
    assert fringed.__version__ == version("fringed") and "__version__" in dir(fringed)


@pytest.mark.parametrize("option", ["--version", "-V"])
def test_the_module_is_the_command_line(option: str) -> None:
    assert module(option).stdout == f"fringed {fringed.__version__}\n"
    assert "Usage: fringed [OPTIONS] COMMAND" in module("-h").stdout


def test_without_the_rig_the_installation_is_described() -> None:
    without = "sys.modules['daemon'] = None"
    process = module("status", before=without)
    assert process.returncode == 2 and process.stderr.count("\n") == 1
    assert "pip install fringed-rig" in process.stderr
    assert module("--version", before=without).stdout == f"fringed {fringed.__version__}\n"


def test_a_foreign_daemon_package_is_named() -> None:
    foreign = "import types; sys.modules['daemon'] = types.ModuleType('daemon')"
    process = module("status", before=foreign)
    assert process.returncode == 2 and process.stderr.count("\n") == 1
    assert "the package 'daemon' in this environment is not that of fringed-rig" in process.stderr
    assert "rig-env/bin/pip install fringed-rig" in process.stderr
