"""Brings a growing file to the disk, and knows up to which frame it is safe there."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal

SYNC_S = 1.0
_JOIN_S = 5.0

Policy = Literal["chunk", "1s", "none"]


@dataclass(frozen=True, slots=True)
class Mark:
    """How far a take is written.

    Args:
        size: bytes; pairs: count; sequence, t_ns: number and start of exposure of the last frame.
    """

    size: int = 0
    pairs: int = 0
    sequence: int | None = None
    t_ns: int = 0


class Syncer:
    """A thread of its own, because a busy disk holds whoever syncs for longer than the recorder's queue lasts.

    Args:
        handle: the descriptor of the file at this moment; None or ValueError while there is none.
        failed: told what the disk says when it cannot keep the data.
        written: how far the take is written at this moment.
        policy: ``1s``: once a second; ``chunk``: the writer calls :meth:`sync` after each; ``none``: nobody does.
    """

    def __init__(
        self,
        handle: Callable[[], int | None],
        failed: Callable[[OSError], object],
        *,
        written: Callable[[], Mark] = Mark,
        policy: Policy = "1s",
    ) -> None:
        self._handle, self._failed, self._written, self.policy = handle, failed, written, policy
        self.synced = Mark()
        self._busy_ns = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)
        if policy == "1s":
            self._thread.start()

    def close(self) -> None:
        """End the thread; a disk that hangs is left behind."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(_JOIN_S)

    def busy_s(self) -> float:
        """How long the disk has kept us waiting by now."""
        began_ns = self._busy_ns
        return (time.monotonic_ns() - began_ns) / 1e9 if began_ns else 0.0

    def status(self) -> dict[str, Any]:
        """The policy, and what is safe."""
        safe = self.synced
        return {"sync": self.policy, "up_to_sequence": safe.sequence, "up_to_ns": safe.t_ns, "bytes": safe.size}

    def _run(self) -> None:
        while not self._stop.wait(SYNC_S):
            try:
                self.sync()
            except OSError as error:
                self._failed(error)

    def all_is(self, mark: Mark) -> None:
        """A file was finished, and with it everything up to here is safe."""
        self.synced = mark

    def sync(self) -> None:
        """Bring what is written to the disk; OSError when the disk cannot."""
        with suppress(ValueError):
            number = self._handle()
            mark = self._written()
            if number is None or mark == self.synced or self._handle() != number:
                return
            self._busy_ns = time.monotonic_ns()
            try:
                self._sync(number)
            finally:
                self._busy_ns = 0
            self.synced = mark

    def _sync(self, number: int) -> None:
        # A descriptor of our own: the writer may close its file meanwhile.
        own = os.dup(number)
        try:
            os.fdatasync(own)
        finally:
            os.close(own)
