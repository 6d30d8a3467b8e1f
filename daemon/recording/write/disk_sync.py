"""Synchronises a growing file with the disk and records up to which frame it is safe there."""

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
class WritePosition:
    """How far a take is written or synchronised.

    Args:
        size: bytes; pairs: count; sequence, t_ns: number and start of exposure of the last frame.
    """

    size: int = 0
    pairs: int = 0
    sequence: int | None = None
    t_ns: int = 0


class DiskSync:
    """Synchronises in a thread of its own: a busy disk can block the call for longer than the recorder's queue lasts.

    Args:
        handle: returns the descriptor of the open file; None or ValueError while there is none.
        failed: called with the error when the disk cannot keep the data.
        written: returns how far the take is written.
        policy: ``1s``: once a second; ``chunk``: the writer calls :meth:`sync` after each; ``none``: never.
    """

    def __init__(
        self,
        handle: Callable[[], int | None],
        failed: Callable[[OSError], object],
        *,
        written: Callable[[], WritePosition] = WritePosition,
        policy: Policy = "1s",
    ) -> None:
        self._handle, self._failed, self._written, self.policy = handle, failed, written, policy
        self.synced = WritePosition()
        self._busy_ns = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)
        if policy == "1s":
            self._thread.start()

    def close(self) -> None:
        """End the thread; it is left behind where the disk hangs."""
        self._stop.set()
        if self._thread.ident is not None:
            self._thread.join(_JOIN_S)

    def busy_s(self) -> float:
        """Return how long the running synchronisation has taken so far."""
        began_ns = self._busy_ns
        return (time.monotonic_ns() - began_ns) / 1e9 if began_ns else 0.0

    def status(self) -> dict[str, Any]:
        """Return the policy and the synchronised position."""
        safe = self.synced
        return {"sync": self.policy, "up_to_sequence": safe.sequence, "up_to_ns": safe.t_ns, "bytes": safe.size}

    def _run(self) -> None:
        while not self._stop.wait(SYNC_S):
            try:
                self.sync()
            except OSError as error:
                self._failed(error)

    def set_synced(self, position: WritePosition) -> None:
        """Record that everything up to this position is safe: the file was finished."""
        self.synced = position

    def sync(self) -> None:
        """Synchronise what is written; OSError when the disk cannot."""
        with suppress(ValueError):
            descriptor = self._handle()
            position = self._written()
            if descriptor is None or position == self.synced or self._handle() != descriptor:
                return
            self._busy_ns = time.monotonic_ns()
            try:
                self._sync(descriptor)
            finally:
                self._busy_ns = 0
            self.synced = position

    def _sync(self, descriptor: int) -> None:
        # A descriptor of our own: the writer may close its file meanwhile.
        own = os.dup(descriptor)
        try:
            os.fdatasync(own)
        finally:
            os.close(own)
