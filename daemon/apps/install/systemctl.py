"""What systemd is told: users, reloads, starts, stops."""

from __future__ import annotations

import os
import shutil
import subprocess

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import SERVICE, UNITS, VIEW, VIEW_USER, X
from daemon.apps.install.target import Target

_TIMEOUT_S = 120


def make_users(target: Target) -> None:
    """The users of the services, by what sysusers.d/fringed.conf says."""
    _must("systemd-sysusers", *([] if target.live else [f"--root={target.root}"]), "fringed.conf")


def take_notice(target: Target) -> None:
    """Let the managers read the new files; what is not there on this machine is left out."""
    if not target.live:
        return
    if target.systemd:
        _must("systemctl", "daemon-reload")
    for command in (["udevadm", "control", "--reload"], ["udevadm", "trigger", "--subsystem-match=usb"]):
        if _there(command[0]):
            _try(*command)


def enable(target: Target, *, projector: bool, view: bool) -> None:
    """Start with the machine from now on."""
    where = [] if target.live else [f"--root={target.root}"]
    units = [SERVICE, *([X] if projector else []), *([VIEW] if view else [])]
    _must("systemctl", *where, "--quiet", "enable", *units)


def start(target: Target, *, projector: bool, view: bool) -> None:
    """Start, or start anew; the daemon itself is ready when the first cloud is there, which is not waited for."""
    if target.systemd:
        units = [*([X] if projector else []), SERVICE, *([VIEW] if view else [])]
        _must("systemctl", "--no-block", "restart", *units)


def stop(target: Target) -> None:
    """Stop everything and start it no more."""
    where = [] if target.live else [f"--root={target.root}"]
    if target.systemd:
        _try("systemctl", "stop", VIEW, SERVICE, X)
    if _there("systemctl"):
        _try("systemctl", *where, "--quiet", "disable", *UNITS)
    if target.systemd:
        _try("systemctl", "reset-failed", *UNITS)


def remove_users(target: Target) -> list[str]:
    """Take the users away; returns what could not be done."""
    said = []
    for user in (VIEW_USER, "fringed"):
        command = ["userdel", *([] if target.live else ["--root", str(target.root)]), user]
        if not _there("userdel") or _try(*command):
            said.append(f"the user {user} stays; remove it with: userdel {user}")
    return said


def _must(*command: str) -> None:
    problem = _try(*command)
    if problem:
        raise InstallError(f"{' '.join(command)} failed: {problem}")


def _path() -> str:
    """Where programs are looked for: sudo and cron may leave out the directories of root's programs."""
    return f"{os.environ.get('PATH', '/usr/bin:/bin')}:/usr/sbin:/sbin"


def _there(program: str) -> bool:
    return shutil.which(program, path=_path()) is not None


def _try(*command: str) -> str:
    """Run a program; what went wrong, or nothing."""
    try:
        done = subprocess.run(
            [shutil.which(command[0], path=_path()) or command[0], *command[1:]], env=os.environ | {"PATH": _path()},
            stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TIMEOUT_S, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        return str(error)
    return (done.stderr.strip()[-500:] or f"exit status {done.returncode}") if done.returncode else ""
