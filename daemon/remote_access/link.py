"""The connection between the daemon and its gate: JSON messages, one a line, over a pair of sockets."""

from __future__ import annotations

import socket
from contextlib import suppress

import msgspec

_MAX_BYTES = 1 << 20


class Link:
    """One end of the connection."""

    def __init__(self, end: socket.socket) -> None:
        self._end, self._text = end, b""

    @property
    def descriptor(self) -> int:
        """Descriptor to poll."""
        return self._end.fileno()

    def send(self, message: msgspec.Struct) -> None:
        """Send a message."""
        self._end.sendall(msgspec.json.encode(message) + b"\n")

    def receive(self, timeout_s: float | None = None) -> bytes | None:
        """Return the next message; None when the other side has closed the connection.

        Raises:
            TimeoutError: none came in time.
        """
        self._end.settimeout(timeout_s)
        try:
            while b"\n" not in self._text:
                more = self._end.recv(65536)
                if not more or len(self._text) > _MAX_BYTES:
                    return None
                self._text += more
        except TimeoutError:
            raise
        except OSError:
            return None
        finally:
            with suppress(OSError):
                self._end.settimeout(None)
        message, _, self._text = self._text.partition(b"\n")
        return message

    def shut_down(self) -> None:
        """Shut the connection down and wake the waiting threads at both ends."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Close the descriptor."""
        self._end.close()
