"""uv installs from where pip is configured to; pip does it where uv cannot."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Sequence

import pytest

from tools import install_packages

SETTINGS = """\
:env:.disable-pip-version-check='1'
:env:.find-links='/opt/wheels /srv/more'
global.cert='/etc/ca.crt'
global.constraint='/etc/pins.txt'
global.extra-index-url='https://one.example/simple\\nhttps://two.example/simple'
global.index-url='https://first.example/simple'
download.index-url='https://other-command.example/simple'
"""
Runs = list[Sequence[str]]


def test_pips_sources_are_uvs_options() -> None:
    found = install_packages.uv_options(SETTINGS.replace("\\n", " "))
    assert found is not None
    options, variables = found
    assert list(zip(options[::2], options[1::2], strict=True)) == [
        ("--default-index", "https://first.example/simple"),
        ("--index", "https://one.example/simple"),
        ("--index", "https://two.example/simple"),
        ("--find-links", "/opt/wheels"),
        ("--find-links", "/srv/more"),
        ("--constraint", "/etc/pins.txt"),
    ]
    assert variables == {"SSL_CERT_FILE": "/etc/ca.crt"}


def test_settings_of_the_command_replace_general_ones_and_the_environment_both() -> None:
    lines = "global.index-url='https://a.example'\ninstall.index-url='https://b.example'\n"
    assert install_packages.uv_options(lines) == (["--default-index", "https://b.example"], {})
    lines = f":env:.index-url='https://c.example'\n{lines}"  # the order in which pip prints them
    assert install_packages.uv_options(lines) == (["--default-index", "https://c.example"], {})


@pytest.mark.parametrize("setting", ["no-index", "proxy", "trusted-host", "no-binary", "target", "one of a later pip"])
def test_other_settings_are_left_to_pip(setting: str) -> None:
    assert install_packages.uv_options(f"global.{setting}='x'\n") is None


@pytest.fixture
def runs(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Runs]:
    """``runs(settings, failing)`` installs flask where commands with any of the failing arguments fail."""

    def install(settings: str = "", failing: Sequence[str] = ()) -> Runs:
        made: Runs = []

        def run(command: Sequence[str], **_: object) -> subprocess.CompletedProcess[str]:
            made.append(command[1:])
            failed = any(each in command[2:] for each in failing)
            return subprocess.CompletedProcess(command, int(failed), stdout=settings)

        monkeypatch.setattr(subprocess, "run", run)
        assert install_packages.main(["flask"]) == 0
        return made[1:]

    return install


def test_uv_installs_the_packages(runs: Callable[..., Runs]) -> None:
    first, second = runs("global.find-links='/opt/wheels'\n")
    assert first[:2] == ["-m", "pip"] and first[-1] == "uv"
    assert second[:4] == ["-m", "uv", "pip", "install"] and second[-1] == "flask"
    assert second[second.index("--find-links") + 1] == "/opt/wheels"
    assert second[second.index("--python") + 1] == sys.executable
    assert "--constraint" in first and "--constraint" in second


@pytest.mark.parametrize(("settings", "failing"), [("global.proxy='x'\n", []), ("", ["uv"])])
def test_pip_installs_them_otherwise(runs: Callable[..., Runs], settings: str, failing: list[str]) -> None:
    last = runs(settings, failing)[-1]
    assert last[:2] == ["-m", "pip"] and last[-1] == "flask" and "--constraint" in last


def test_the_status_is_that_of_pip(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(install_packages, "PIP", [sys.executable, "-c", "raise SystemExit(3)"])
    assert install_packages.main(["flask"]) == 3
