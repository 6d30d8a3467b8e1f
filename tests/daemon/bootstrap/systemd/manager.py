"""A service manager for tests: a socket that receives the daemon's messages."""

from __future__ import annotations

import secrets
import socket
from pathlib import Path

import pytest

from tools.waiting import wait_until

PATIENT = pytest.mark.timeout(400)
"""For tests that wait for other processes and threads: each wait has a limit of its own, for busy machines."""


class Manager:
    """Keeps every message, one dictionary each; reads only on request."""

    def __init__(self, address: str) -> None:
        self.address = address
        self.messages: list[dict[str, str]] = []
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._socket.bind("\0" + address[1:] if address.startswith("@") else address)
        self._socket.setblocking(False)

    @classmethod
    def at_path(cls, tmp_path: Path) -> Manager:
        return cls(str(tmp_path / "notify"))

    @classmethod
    def abstract(cls) -> Manager:
        return cls(f"@fringed-test-{secrets.token_hex(8)}")

    def environment(self, watchdog_us: int | None = None) -> dict[str, str]:
        watchdog = {"WATCHDOG_USEC": str(watchdog_us)} if watchdog_us is not None else {}
        return {"NOTIFY_SOCKET": self.address} | watchdog

    def read(self) -> list[dict[str, str]]:
        """Return the messages since the last call."""
        new = []
        while True:
            try:
                data = self._socket.recv(65536)
            except BlockingIOError:
                break
            new.append(dict(line.split("=", 1) for line in data.decode().splitlines()))
        self.messages += new
        return new

    def values(self, key: str) -> list[str]:
        """Return every value of a variable so far, in order."""
        self.read()
        return [message[key] for message in self.messages if key in message]

    def wait_for(self, key: str, value: str | None = None, timeout_s: float = 90.0) -> str:
        """Wait for a variable (with a part of its value); return the value."""

        def found() -> str | None:
            return next((text for text in self.values(key) if value is None or value in text), None)

        wait_until(lambda: found() is not None, timeout_s)
        result = found()
        assert result is not None
        return result

    def close(self) -> None:
        self._socket.close()
