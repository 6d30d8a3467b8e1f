"""Messages to the service manager, sd_notify(3): one datagram each, never waiting."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import MutableMapping

_MAX_STATUS = 400  # characters; systemctl shows one line
_VARIABLES = "NOTIFY_SOCKET", "WATCHDOG_USEC", "WATCHDOG_PID"


class Notifier:
    """Sends messages to a service manager; does nothing where there is none.

    Args:
        address: of the manager's socket, a path or ``@`` and an abstract name; empty = there is none.
        watchdog_s: how often the manager expects a message; None = it has no watchdog.
    """

    def __init__(self, address: str = "", *, watchdog_s: float | None = None) -> None:
        self.watchdog_s = watchdog_s if address else None
        self.failed = 0
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) if address else None

    @classmethod
    def from_environment(cls, environ: MutableMapping[str, str] | None = None) -> Notifier:
        """The one that systemd's variables describe; they are removed, so that no child sends in the daemon's name."""
        variables = os.environ if environ is None else environ
        address, interval, pid = (variables.pop(name, "") for name in _VARIABLES)
        watched = interval.isdigit() and int(interval) > 0 and pid in ("", str(os.getpid()))
        return cls(address if address[:1] in ("/", "@") else "", watchdog_s=int(interval) / 1e6 if watched else None)

    @property
    def active(self) -> bool:
        """Whether there is a manager."""
        return self._socket is not None

    def ready(self, status: str) -> bool:
        """Report that starting, or reloading, is done."""
        return self._send("READY=1", _status(status))

    def status(self, text: str) -> bool:
        """One line for ``systemctl status``."""
        return self._send(_status(text))

    def alive(self) -> bool:
        """Feed the watchdog."""
        return self._send("WATCHDOG=1")

    def extend(self, seconds: float) -> bool:
        """Extend the time-out of starting: the manager gives up when no message comes for so long."""
        return self._send(f"EXTEND_TIMEOUT_USEC={round(1e6 * seconds)}")

    def reloading(self) -> bool:
        """Report that a reload begins; :meth:`ready` ends it."""
        return self._send("RELOADING=1", f"MONOTONIC_USEC={time.monotonic_ns() // 1000}")

    def stopping(self) -> bool:
        """Report that the daemon stops."""
        return self._send("STOPPING=1", _status("stopping"))

    def close(self) -> None:
        """Send nothing more; may be called twice."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _send(self, *lines: str) -> bool:
        """Send without waiting for a manager that does not read; whether it was sent."""
        if self._socket is None:
            return False
        try:
            data = "\n".join(lines).encode()
            self._socket.sendto(data, socket.MSG_DONTWAIT | socket.MSG_NOSIGNAL, self._address)
        except OSError:
            self.failed += 1
            return False
        return True


def _status(text: str) -> str:
    return f"STATUS={' '.join(text.split())[:_MAX_STATUS]}"
