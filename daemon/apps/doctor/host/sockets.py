"""Where stream and control are bound: free, or in use by whom; and whether the sockets' directory can be written."""

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
from daemon.common import ipc_endpoints
from daemon.common.places import existing

area = Area("sockets")

_LISTEN = "0A"


def check(subject: Subject) -> Iterator[Finding]:
    """Every endpoint, then the directories of those on this machine."""
    config = subject.config
    stream = (
        config.stream.endpoints if config is not None else [ipc_endpoints.stream_endpoint(), ipc_endpoints.TCP_STREAM]
    )
    control = config.control.endpoint if config is not None else ipc_endpoints.control_endpoint()
    remote = [("control", each) for each in config.control.remote] if config is not None else []
    directories: dict[Path, None] = {}
    for what, endpoint in [*(("stream", each) for each in stream), ("control", control), *remote]:
        if endpoint.startswith("ipc://"):
            path = Path(endpoint.removeprefix("ipc://"))
            directories[path.parent] = None
            yield local(subject.machine, what, endpoint, path)
        else:
            yield port(subject.machine, what, endpoint)
    for directory in directories:
        yield writable(directory)


def local(machine: Machine, what: str, endpoint: str, path: Path) -> Finding:
    """A socket file."""
    try:
        if not path.exists():
            return area.ok(what, f"{what}: {endpoint} is free")
        if not stat.S_ISSOCK(path.stat().st_mode):
            return area.problem(
                what, f"{what}: {path} is no socket", f"rm {path}, or change {what}'s endpoint in rig.yaml"
            )
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
            probe.settimeout(1.0)
            probe.connect(str(path))
            pid, _, _ = struct.unpack("iII", probe.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, 12))
    except ConnectionRefusedError:
        return area.ok(what, f"{what}: {endpoint} is free; a daemon that died left its file, the next one removes it")
    except OSError as error:
        text = f"{what}: {endpoint} cannot be used: {error.strerror or error}"
        return area.problem(what, text, f"choose another path for the {what}'s endpoint in rig.yaml")
    return taken(what, endpoint, machine.program(pid))


def port(machine: Machine, what: str, endpoint: str) -> Finding:
    """A TCP port."""
    try:
        parts = urlsplit(endpoint)
        number, host = parts.port, parts.hostname or ""
    except ValueError:
        number, host = None, ""
    if not number:
        return area.ok(what, f"{what}: {endpoint} takes any free port")
    for address, inode in listening(machine, number):
        if address.is_unspecified or str(address) == {"localhost": "127.0.0.1"}.get(host, host) or host == "*":
            return taken(what, endpoint, holder(machine, inode))
    return area.ok(what, f"{what}: {endpoint} is free")


def taken(what: str, endpoint: str, program: Program | None) -> Finding:
    """The finding of an endpoint that somebody uses."""
    if program is not None and program.is_daemon:
        text = f"{what}: {endpoint} is in use by a running daemon, {program}"
        return area.warning(
            what, text, f"stop it before another is started: kill -INT {program.pid}; see: fringed status"
        )
    who = str(program) if program is not None else "a program of another user"
    remedy = (
        f"end it{f': kill {program.pid}' if program is not None else ''}, or change the {what}'s endpoint in rig.yaml"
    )
    return area.problem(what, f"{what}: {endpoint} is in use by {who}", remedy)


def listening(machine: Machine, number: int) -> Iterator[tuple[ipaddress.IPv4Address | ipaddress.IPv6Address, str]]:
    """Address and socket number of everything that listens on a port."""
    for name in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in machine.text(name).splitlines()[1:]:
            fields = line.split()
            if len(fields) < 10 or fields[3] != _LISTEN:
                continue
            address, _, own = fields[1].partition(":")
            if int(own, 16) == number:
                # Each group of four bytes is in the processor's order, which is little-endian here.
                words = [bytes.fromhex(address[i : i + 8])[::-1] for i in range(0, len(address), 8)]
                yield ipaddress.ip_address(b"".join(words)), fields[9]


def holder(machine: Machine, inode: str) -> Program | None:
    """The program that has a socket, None where that is hidden from this user."""
    wanted = f"socket:[{inode}]"
    for program in machine.programs():
        try:
            links = list(machine.path(f"/proc/{program.pid}/fd").iterdir())
        except OSError:
            continue
        for link in links:
            try:
                if str(link.readlink()) == wanted:
                    return program
            except OSError:
                continue
    return None


def writable(directory: Path) -> Finding:
    """The directory of socket files; the daemon makes it."""
    above = existing(directory)
    mine = above.stat().st_uid == os.geteuid() or directory != above or not directory.name.startswith("fringed")
    if above.is_dir() and mine and os.access(above, os.W_OK | os.X_OK):
        return area.ok("directory", f"{directory} {'can be written' if above == directory else 'can be made'}")
    why = "belongs to another user" if not mine else "cannot be written"
    remedy = "set XDG_RUNTIME_DIR to a directory of your own, or under systemd set RuntimeDirectory=fringed"
    return area.problem("directory", f"the sockets' directory {directory}: {above} {why}", remedy)
