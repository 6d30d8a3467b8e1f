"""Commands for systemd: users, reloads, starts, stops."""

from __future__ import annotations

import os
import shutil
import subprocess

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import SERVICE, UNITS, VIEW, VIEW_USER, X
from daemon.apps.install.target import Target

_TIMEOUT_S = 120


def make_users(target: Target) -> None:
    """Create the users of the services according to sysusers.d/fringed.conf."""
    _require("systemd-sysusers", *([] if target.live else [f"--root={target.root}"]), "fringed.conf")


def reload_managers(target: Target) -> None:
    """Make systemd and udev read the new files; missing managers are left out."""
    if not target.live:
        return
    if target.systemd:
        _require("systemctl", "daemon-reload")
    for command in (["udevadm", "control", "--reload"], ["udevadm", "trigger", "--subsystem-match=usb"]):
        if _is_installed(command[0]):
            _run(*command)


def enable(target: Target, *, projector: bool, view: bool) -> None:
    """Enable the start at boot."""
    image = [] if target.live else [f"--root={target.root}"]
    units = [SERVICE, *([X] if projector else []), *([VIEW] if view else [])]
    _require("systemctl", *image, "--quiet", "enable", *units)


def start(target: Target, *, projector: bool, view: bool) -> None:
    """Start or restart the services, without waiting for the first cloud."""
    if target.systemd:
        units = [*([X] if projector else []), SERVICE, *([VIEW] if view else [])]
        _require("systemctl", "--no-block", "restart", *units)


def stop(target: Target) -> None:
    """Stop and disable all services."""
    image = [] if target.live else [f"--root={target.root}"]
    if target.systemd:
        _run("systemctl", "stop", VIEW, SERVICE, X)
    if _is_installed("systemctl"):
        _run("systemctl", *image, "--quiet", "disable", *UNITS)
    if target.systemd:
        _run("systemctl", "reset-failed", *UNITS)


def remove_users(target: Target) -> list[str]:
    """Remove the users; returns messages about failures."""
    messages = []
    for user in (VIEW_USER, "fringed"):
        command = ["userdel", *([] if target.live else ["--root", str(target.root)]), user]
        if not _is_installed("userdel") or _run(*command):
            messages.append(f"the user {user} was not removed; remove it with: userdel {user}")
    return messages


def _require(*command: str) -> None:
    problem = _run(*command)
    if problem:
        raise InstallError(f"{' '.join(command)} failed: {problem}")


def _path() -> str:
    """The search path, with the directories of root's programs that sudo and cron may omit."""
    return f"{os.environ.get('PATH', '/usr/bin:/bin')}:/usr/sbin:/sbin"


def _is_installed(program: str) -> bool:
    return shutil.which(program, path=_path()) is not None


def _run(*command: str) -> str:
    """Run a program; returns the error, empty on success."""
    try:
        process = subprocess.run(
            [shutil.which(command[0], path=_path()) or command[0], *command[1:]], env=os.environ | {"PATH": _path()},
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return (process.stderr.strip()[-500:] or f"exit status {process.returncode}") if process.returncode else ""
