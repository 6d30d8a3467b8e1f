"""Words between the daemon and its gate: JSON, one a line, over a pair of sockets."""

from __future__ import annotations

import socket
from contextlib import suppress

import msgspec

_MAX_BYTES = 1 << 20


class Link:
    """One end."""

    def __init__(self, end: socket.socket) -> None:
        self._end, self._text = end, b""

    @property
    def descriptor(self) -> int:
        """To wait for."""
        return self._end.fileno()

    def say(self, word: msgspec.Struct) -> None:
        """Send a word."""
        self._end.sendall(msgspec.json.encode(word) + b"\n")

    def next(self, timeout_s: float | None = None) -> bytes | None:
        """The next word; None when the other side has hung up.

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
        word, _, self._text = self._text.partition(b"\n")
        return word

    def hang_up(self) -> None:
        """Wake whoever waits, here and there."""
        with suppress(OSError):
            self._end.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Let go of it."""
        self._end.close()
