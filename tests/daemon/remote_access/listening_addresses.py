"""On which addresses a process and its children listen, by the kernel's own tables."""

from __future__ import annotations

import ipaddress
from contextlib import suppress
from pathlib import Path

_LISTEN = "0A"


def family(pid: int) -> list[int]:
    """A process and everything that it started."""
    found = [pid]
    for children in Path(f"/proc/{pid}/task").glob("*/children"):
        with suppress(OSError):
            for child in children.read_text().split():
                found += family(int(child))
    return found


def addresses(pid: int) -> set[tuple[str, int]]:
    """Address and port of every TCP socket that one of the family listens on."""
    own = {link for one in family(pid) for link in _sockets(one)}
    found = set()
    for table in ("tcp", "tcp6"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == _LISTEN and f"socket:[{fields[9]}]" in own:
                address, _, port = fields[1].partition(":")
                groups = [bytes.fromhex(address[i : i + 8])[::-1] for i in range(0, len(address), 8)]
                found.add((str(ipaddress.ip_address(b"".join(groups))), int(port, 16)))
    return found


def _sockets(pid: int) -> set[str]:
    links = set()
    with suppress(OSError):
        for link in Path(f"/proc/{pid}/fd").iterdir():
            with suppress(OSError):
                links.add(str(link.readlink()))
    return links
