"""Losses seen by a subscriber: gaps in the numbers of the clouds of one session."""

from __future__ import annotations

_MODULUS = 1 << 32


class Losses:
    """Counts the numbers that were passed over; a new session starts afresh, numbers wrap at 2**32."""

    def __init__(self) -> None:
        self.count = 0
        self._session: str | None = None
        self._last = 0

    def see(self, session: str, seq: int) -> None:
        """Take note of a message."""
        if session == self._session:
            step = (seq - self._last) % _MODULUS
            if step == 0 or step >= _MODULUS // 2:
                return  # a repeated or late message closes no gap
            self.count += step - 1
        self._session, self._last = session, seq
