"""Count of lost clouds: gaps in the sequence numbers of one session."""

from __future__ import annotations

_MODULUS = 1 << 32


class Losses:
    """Counts the missing sequence numbers; a new session starts a new sequence, numbers wrap at 2**32."""

    def __init__(self) -> None:
        self.count = 0
        self._session: str | None = None
        self._last = 0

    def add(self, session: str, seq: int) -> None:
        """Add the number of a received message."""
        if session == self._session:
            step = (seq - self._last) % _MODULUS
            if step == 0 or step >= _MODULUS // 2:
                return  # a repeated or late message closes no gap
            self.count += step - 1
        self._session, self._last = session, seq
