"""The unit files: their settings, and their verification by systemd itself."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
from collections import defaultdict
from pathlib import Path

import pytest

from daemon.apps.install import layout
from daemon.apps.install.files import sources
from daemon.apps.install.layout import FILES, PROGRAMS, UNITS
from daemon.cli.measure.run import WRONG_CONFIG
from tests.daemon.bootstrap.systemd.manager import PATIENT

pytestmark = PATIENT

MAX_EXPOSURE = 2.5


def needs_systemd() -> None:
    """Skip where systemd's tools are not installed; in CI they must be."""
    if shutil.which("systemd-analyze") is None:
        reason = "systemd-analyze is not installed; tools/system-packages systemd installs it"
        if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
            pytest.fail(reason)
        pytest.skip(reason)


def unit(name: str) -> dict[str, list[str]]:
    """Return every value of every key of a unit file."""
    values: dict[str, list[str]] = defaultdict(list)
    for line in (sources() / name).read_text().splitlines():
        if line and line[0] not in "#;[":
            key, _, value = line.partition("=")
            values[key].append(value)
    return values


def test_every_file_beside_the_units_is_installed() -> None:
    there = {str(path.relative_to(sources())) for path in sources().rglob("*") if path.is_file()}
    assert there == set(FILES) | set(PROGRAMS)


def test_the_daemon_has_a_watchdog_and_is_restarted() -> None:
    daemon = unit(layout.SERVICE)
    assert daemon["Type"] == ["notify"] and daemon["NotifyAccess"] == ["main"]
    assert daemon["WatchdogSec"] == ["10"] and daemon["Restart"] == ["on-failure"]
    assert daemon["RestartPreventExitStatus"] == [str(WRONG_CONFIG)]
    assert daemon["ExecReload"][-1] == "/bin/kill -HUP $MAINPID"
    assert daemon["ExecStart"] == [f"{layout.PREFIX}/bin/fringed run {layout.RIG}"]


def test_directories_of_the_unit_are_those_of_the_table() -> None:
    daemon, by_path = unit(layout.SERVICE), {entry.path: entry for entry in layout.DIRECTORIES}
    for kind, above in (("State", "/var/lib"), ("Cache", "/var/cache"), ("Logs", "/var/log")):
        (name,), (mode,) = daemon[f"{kind}Directory"], daemon[f"{kind}DirectoryMode"]
        entry = by_path[Path(above) / name]
        assert (entry.mode, entry.owner, entry.group) == (int(mode, 8), layout.USER, layout.USER)
    assert daemon["RuntimeDirectoryMode"] == ["0750"]
    assert f"NUMBA_CACHE_DIR={layout.KERNELS}" in " ".join(daemon["Environment"])


def test_modes_and_owners_of_tmpfiles_are_those_of_the_table() -> None:
    lines = (sources() / "tmpfiles.d/fringed.conf").read_text().splitlines()
    listed = {fields[1]: fields[2:5] for line in lines if (fields := line.split()) and fields[0] == "d"}
    assert set(listed) <= {str(entry.path) for entry in layout.DIRECTORIES}
    for entry in layout.DIRECTORIES:
        if str(entry.path) in listed:
            assert listed[str(entry.path)] == [f"{entry.mode:04o}", entry.owner, entry.group]


@pytest.mark.parametrize("name", UNITS)
def test_no_capability_and_only_its_own_directories_writable(name: str) -> None:
    values = unit(name)
    assert values["CapabilityBoundingSet"] == [""] and values["AmbientCapabilities"] == [""]
    assert values["NoNewPrivileges"] == ["yes"] and values["ProtectSystem"] == ["strict"]
    assert values["ProtectHome"] == ["yes"] and values["DevicePolicy"] == ["closed"]


def test_the_measuring_may_compile_and_choose_processors() -> None:
    daemon = unit(layout.SERVICE)
    assert "MemoryDenyWriteExecute" not in daemon
    assert not any("@resources" in value for value in daemon["SystemCallFilter"])


def test_the_viewer_is_reachable_from_this_machine_only() -> None:
    view = unit(layout.VIEW)
    assert view["IPAddressDeny"] == ["any"] and view["IPAddressAllow"] == ["localhost"]
    assert view["User"] == [layout.VIEW_USER]


@pytest.mark.parametrize("name", UNITS)
def test_exposure_is_within_the_limit(name: str) -> None:
    needs_systemd()
    command = ["systemd-analyze", "security", "--no-pager", "--offline=yes", str(sources() / name)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", process.stdout)
    assert found is not None, process.stdout + process.stderr
    assert float(found[1]) <= MAX_EXPOSURE


@pytest.mark.parametrize("name", [*UNITS, "user/fringed-user.service"])
def test_systemd_accepts_every_line(name: str, tmp_path: Path) -> None:
    needs_systemd()
    # Placeholders for programs that the units name, so that only real errors are reported.
    text = (sources() / name).read_text()
    stand_in = tmp_path / "program"
    stand_in.write_text("#!/bin/sh\n")
    stand_in.chmod(0o755)
    text = re.sub(r"^(Exec\w+=)(/opt/fringed\S+|/usr/lib/xorg/Xorg)", rf"\g<1>{stand_in}", text, flags=re.MULTILINE)
    text = re.sub(r"^Documentation=.*\n", "", text, flags=re.MULTILINE)
    path = tmp_path / Path(name).name
    path.write_text(text)
    user = ["--user"] if name.startswith("user/") else []
    environ = os.environ | {"XDG_RUNTIME_DIR": str(tmp_path), "SYSTEMD_UNIT_PATH": f"{tmp_path}:"}
    process = subprocess.run(
        ["systemd-analyze", *user, "verify", "--recursive-errors=no", str(path)],
        capture_output=True, text=True, timeout=60, check=False, env=environ,
    )  # fmt: skip
    errors = [line for line in process.stderr.splitlines() if path.name in line and "not found" not in line]
    assert errors == []


def test_an_error_in_a_unit_is_detected(tmp_path: Path) -> None:
    needs_systemd()
    path = tmp_path / "fringed.service"
    path.write_text("[Service]\nExecStart=/bin/true\nProtectSytem=strict\n")
    command = ["systemd-analyze", "verify", "--recursive-errors=no", str(path)]
    process = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert "ProtectSytem" in process.stderr


def test_the_schema_of_the_key_of_the_x_server(tmp_path: Path) -> None:
    program = sources() / "libexec/projector-x"
    subprocess.run([program, "prepare", ":99", tmp_path], check=True, timeout=60)
    data = (tmp_path / "authority").read_bytes()
    assert data[:-16] == b"\xff\xff\0\0\0\x0299\0\x12MIT-MAGIC-COOKIE-1\0\x10"
    assert (tmp_path / "authority").stat().st_mode & 0o777 == 0o640
    subprocess.run([program, "prepare", ":99", tmp_path], check=True, timeout=60)
    assert (tmp_path / "authority").read_bytes() != data


def test_constants_are_plain(tmp_path: Path) -> None:
    assert json.dumps([str(entry.path) for entry in layout.DIRECTORIES])
    assert layout.with_prefix(layout.PREFIX / "bin", tmp_path) == tmp_path / "bin"
    assert layout.with_prefix(layout.CONFIG, tmp_path) == layout.CONFIG
