"""The installed service: user, groups, directories, interpreter and state."""

from __future__ import annotations

import stat
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.machine import Machine
from daemon.apps.doctor.subject import Subject
from daemon.apps.install.layout import CONFIG_FILES, DIRECTORIES, PREFIX, SERVICE, USER
from daemon.common.run_program import is_installed, run_program

area = Area("service")

_UNIT = f"/etc/systemd/system/{SERVICE}"
_GROUPS = "video", "render", "plugdev"
_REINSTALL = "sudo fringed install, from the checkout or environment of the first installation"


def check(subject: Subject) -> Iterator[Finding]:
    """Check the installed service; a note if there is none."""
    machine = subject.machine
    unit = machine.text(_UNIT)
    if not unit:
        yield area.note("unit", "fringed is not installed as a service", "sudo fringed install")
        return
    yield program(machine, unit)
    number = entry(machine, "passwd", USER)
    if number is None:
        yield area.problem(
            "user", f"the user {USER} does not exist", f"sudo systemd-sysusers fringed.conf, or {_REINSTALL}"
        )
        return
    yield groups(machine)
    yield from permissions(machine)
    if machine.root == Path("/") and is_installed("systemctl"):
        yield running()


def program(machine: Machine, unit: str) -> Finding:
    """Check the program that the unit starts."""
    line = next((line for line in unit.splitlines() if line.startswith("ExecStart=")), "ExecStart=")
    name = line.partition("=")[2].split(" ")[0] or str(PREFIX)
    env = Path(name).parent.parent / "env/bin/python"
    for path in (name, str(env)):
        if not machine.path(path).exists():
            return area.problem("program", f"{path} does not exist", _REINSTALL)
    return area.ok("program", name)


def groups(machine: Machine) -> Finding:
    """Check the service's groups for cameras and graphics card."""
    missing = [name for name in _GROUPS if USER not in members(machine, name)]
    if missing:
        remedy = f"sudo usermod -aG {','.join(missing)} {USER}; sudo systemctl restart fringed"
        return area.warning("groups", f"the user {USER} is not in {' and '.join(missing)}", remedy)
    return area.ok("groups", f"the user {USER} is in {', '.join(_GROUPS)}")


def permissions(machine: Machine) -> Iterator[Finding]:
    """Compare modes and owners with the table of the installation; one finding if all agree."""
    wrong = 0
    for expected in (*DIRECTORIES, CONFIG_FILES):
        if expected.path.is_relative_to(PREFIX):
            continue  # the prefix is an option of the installation
        try:
            status = machine.path(str(expected.path)).stat()
        except PermissionError:
            continue
        except OSError:
            wrong += 1
            yield area.warning("rights", f"{expected.path} does not exist", _REINSTALL)
            continue
        owner, group = entry(machine, "passwd", expected.owner), entry(machine, "group", expected.group)
        if status.st_uid != owner or status.st_gid != group or stat.S_IMODE(status.st_mode) & ~expected.mode:
            wrong += 1
            path, mode, names = expected.path, f"{expected.mode:04o}", f"{expected.owner}:{expected.group}"
            remedy = f"sudo chown {names} {path}; sudo chmod {mode} {path}"
            yield area.warning("rights", f"{path} is not {mode} {names}", remedy)
    if not wrong:
        yield area.ok("rights", "configuration and data have the modes and owners of the installation")


def running() -> Finding:
    """Report the state from systemd."""
    names = ("ActiveState", "StatusText", "NRestarts", "Result")
    answer = run_program(["systemctl", "show", SERVICE, *(f"--property={name}" for name in names)], 10.0)
    values = dict(line.partition("=")[::2] for line in answer.out.splitlines())
    state = values.get("ActiveState", "")
    if not state:
        return area.note("state", "systemd does not report the service's state")
    text = f"{state}, {values.get('NRestarts', '?')} restarts; {values.get('StatusText') or 'no status line'}"
    if state == "failed":
        return area.warning("state", f"{text} ({values.get('Result')})", "journalctl -u fringed -n 50")
    return area.ok("state", text)


def entry(machine: Machine, table: str, name: str) -> int | None:
    """The id of a user (``passwd``) or a group (``group``), None if it does not exist."""
    fields = _line(machine, table, name)
    if len(fields) > 2 and fields[2].isdigit():
        return int(fields[2])
    return 0 if name == "root" else None


def members(machine: Machine, group: str) -> list[str]:
    """The members of a group in /etc/group."""
    fields = _line(machine, "group", group)
    return fields[3].split(",") if len(fields) > 3 else []


def _line(machine: Machine, table: str, name: str) -> list[str]:
    lines = (line.split(":") for line in machine.text(f"/etc/{table}").splitlines())
    return next((fields for fields in lines if fields[0] == name), [])
