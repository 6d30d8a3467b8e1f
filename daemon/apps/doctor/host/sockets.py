"""The endpoints of stream and control: free or in use, and the permissions of the sockets' directory."""

from __future__ import annotations

import ipaddress
import os
import socket
import stat
import struct
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from daemon.apps.doctor.finding import Area, Finding
from daemon.apps.doctor.machine import Machine, Program
from daemon.apps.doctor.subject import Subject
from daemon.common.files import existing_parent
from fringed.control.address import TCP_STREAM, control_endpoint, stream_endpoint

area = Area("sockets")

_LISTEN = "0A"


def check(subject: Subject) -> Iterator[Finding]:
    """Check every endpoint, then the directories of the local ones."""
    config = subject.config
    stream = config.stream.endpoints if config is not None else [stream_endpoint(), TCP_STREAM]
    control = config.control.endpoint if config is not None else control_endpoint()
    remote = [("control", each) for each in config.control.remote] if config is not None else []
    directories: dict[Path, None] = {}
    for name, endpoint in [*(("stream", each) for each in stream), ("control", control), *remote]:
        if endpoint.startswith("ipc://"):
            path = Path(endpoint.removeprefix("ipc://"))
            directories[path.parent] = None
            yield local(subject.machine, name, endpoint, path)
        else:
            yield port(subject.machine, name, endpoint)
    for directory in directories:
        yield writable(directory)


def local(machine: Machine, name: str, endpoint: str, path: Path) -> Finding:
    """Check a socket file."""
    try:
        if not path.exists():
            return area.ok(name, f"{name}: {endpoint} is free")
        if not stat.S_ISSOCK(path.stat().st_mode):
            return area.problem(
                name, f"{name}: {path} is no socket", f"rm {path}, or change {name}'s endpoint in rig.yaml"
            )
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(str(path))
            pid, _, _ = struct.unpack("iII", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    except ConnectionRefusedError:
        return area.ok(
            name,
            f"{name}: {endpoint} is free; its file is left from an earlier daemon, the next one removes it",
        )
    except OSError as error:
        text = f"{name}: {endpoint} is not usable: {error.strerror or error}"
        return area.problem(name, text, f"choose another path for the {name}'s endpoint in rig.yaml")
    return in_use(name, endpoint, machine.program(pid))


def port(machine: Machine, name: str, endpoint: str) -> Finding:
    """Check a TCP port."""
    try:
        parts = urlsplit(endpoint)
        number, host = parts.port, parts.hostname or ""
    except ValueError:
        number, host = None, ""
    if not number:
        return area.ok(name, f"{name}: {endpoint} uses any free port")
    for address, inode in listening(machine, number):
        if address.is_unspecified or str(address) == {"localhost": "127.0.0.1"}.get(host, host) or host == "*":
            return in_use(name, endpoint, holder(machine, inode))
    return area.ok(name, f"{name}: {endpoint} is free")


def in_use(name: str, endpoint: str, program: Program | None) -> Finding:
    """The finding for an endpoint in use."""
    if program is not None and program.is_daemon:
        text = f"{name}: {endpoint} is in use by a running daemon, {program}"
        return area.warning(
            name, text, f"stop it before starting another one: kill -INT {program.pid}; see: fringed status"
        )
    user = str(program) if program is not None else "a program of another user"
    remedy = (
        f"end it{f': kill {program.pid}' if program is not None else ''}, or change the {name}'s endpoint in rig.yaml"
    )
    return area.problem(name, f"{name}: {endpoint} is in use by {user}", remedy)


def listening(machine: Machine, number: int) -> Iterator[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, str]]:
    """Address and inode of every socket that listens on a port."""
    for name in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in machine.text(name).splitlines()[1:]:
            fields = line.split()
            if len(fields) < 10 or fields[3] != _LISTEN:
                continue
            address, _, own = fields[1].partition(":")
            if int(own, 16) == number:
                # Each group of four bytes is in the processor's order, little-endian.
                groups = [bytes.fromhex(address[i : i + 8])[::-1] for i in range(0, len(address), 8)]
                yield ipaddress.ip_address(b"".join(groups)), fields[9]


def holder(machine: Machine, inode: str) -> Program | None:
    """The program that owns a socket, None if it is hidden from this user."""
    target = f"socket:[{inode}]"
    for program in machine.programs():
        try:
            links = list(machine.path(f"/proc/{program.pid}/fd").iterdir())
        except OSError:
            continue
        for link in links:
            try:
                if str(link.readlink()) == target:
                    return program
            except OSError:
                continue
    return None


def writable(directory: Path) -> Finding:
    """Check the directory of socket files, which the daemon creates."""
    parent = existing_parent(directory)
    owned = parent.stat().st_uid == os.geteuid() or directory != parent or not directory.name.startswith("fringed")
    if parent.is_dir() and owned and os.access(parent, os.W_OK | os.X_OK):
        return area.ok("directory", f"{directory} {'is writable' if parent == directory else 'can be created'}")
    problem = "belongs to another user" if not owned else "is not writable"
    remedy = "set XDG_RUNTIME_DIR to a directory of your own, or under systemd set RuntimeDirectory=fringed"
    return area.problem("directory", f"the sockets' directory {directory}: {parent} {problem}", remedy)
