"""Which chunks of a recording may start, and which of their results hold: the order in which state is carried."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from daemon.apps.reprocess.carried_state import CarriedState


class Phase(Enum):
    """Of a chunk: to be started, running, done, or failed for good."""

    OPEN, RUNNING, DONE, FAILED = range(4)


@dataclass(slots=True)
class _Chunk:
    phase: Phase = Phase.OPEN
    before: CarriedState | None = None
    after: CarriedState | None = None
    reason: str = ""


class TakeProgress:
    """The chunks of one recording.

    A chunk begins with the state that the one before it left. Once that state is settled all later chunks start with
    it, at the same time; a result counts only if the state before it turns out to be the one it began with, otherwise
    the chunk is done again.

    Args:
        chunks: number of chunks.
    """

    def __init__(self, chunks: int) -> None:
        self._chunks = [_Chunk() for _ in range(chunks)]
        self._state = CarriedState()
        self._next = 0  # the first chunk whose result is not known to hold

    @property
    def complete(self) -> bool:
        """Whether no chunk can change any more."""
        return self._next == len(self._chunks) and not any(c.phase is Phase.RUNNING for c in self._chunks)

    @property
    def failures(self) -> dict[int, str]:
        """Reasons of the failed chunks by number."""
        return {n: chunk.reason for n, chunk in enumerate(self._chunks) if chunk.phase is Phase.FAILED}

    def ready(self) -> Iterator[tuple[int, CarriedState]]:
        """Yield number and state of every chunk that may start now."""
        for number in range(self._next, len(self._chunks)):
            if number > self._next and not self._state.settled:
                return
            if self._chunks[number].phase is Phase.OPEN:
                yield number, self._state

    def started(self, number: int) -> None:
        """Note that a chunk runs."""
        self._chunks[number].phase = Phase.RUNNING

    def reopened(self, number: int) -> None:
        """Note that a chunk that ran must run again."""
        self._chunks[number].phase = Phase.OPEN

    def done(self, number: int, before: CarriedState, after: CarriedState) -> None:
        """Note the result of a chunk that began with ``before``."""
        self._chunks[number] = _Chunk(Phase.DONE, before, after)
        self._advance()

    def failed(self, number: int, reason: str) -> None:
        """Note that a chunk has no result and will have none in this run."""
        self._chunks[number] = _Chunk(Phase.FAILED, reason=reason)
        self._advance()

    def _advance(self) -> None:
        while self._next < len(self._chunks):
            chunk = self._chunks[self._next]
            if chunk.phase is Phase.DONE and chunk.before == self._state and chunk.after is not None:
                self._state = chunk.after
            elif chunk.phase is Phase.FAILED:
                if not self._state.settled:
                    self._fail_rest()
                    return
            else:
                break
            self._next += 1
        self._reopen()

    def _reopen(self) -> None:
        """Open results that began with another state than the one that holds now."""
        last = len(self._chunks) if self._state.settled else self._next + 1
        for chunk in self._chunks[self._next : last]:
            if chunk.phase is Phase.DONE and chunk.before != self._state:
                chunk.phase = Phase.OPEN

    def _fail_rest(self) -> None:
        first = self._chunks[self._next].reason
        for chunk in self._chunks[self._next + 1 :]:
            if chunk.phase is not Phase.RUNNING:
                chunk.phase = Phase.FAILED
                chunk.reason = f"the column correction is unknown, for an earlier chunk failed: {first}"
        self._next = len(self._chunks)
