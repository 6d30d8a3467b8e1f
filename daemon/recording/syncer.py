"""Brings a growing file to the disk once a second, beside the thread that writes it."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress

SYNC_S = 1.0
_JOIN_S = 5.0


class Syncer:
    """A thread of its own, because a busy disk holds whoever syncs for longer than the recorder's queue lasts.

    Args:
        handle: the descriptor of the file at this moment; None or ValueError while there is none.
        failed: told what the disk says when it cannot keep the data.
    """

    def __init__(self, handle: Callable[[], int | None], failed: Callable[[OSError], object]) -> None:
        self._handle, self._failed = handle, failed
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="recorder-sync", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; a disk that hangs is left behind."""
        self._stop.set()
        self._thread.join(_JOIN_S)

    def _run(self) -> None:
        while not self._stop.wait(SYNC_S):
            try:
                self.sync()
            except OSError as error:
                self._failed(error)
                return

    def sync(self) -> None:
        """Bring what is written to the disk; OSError when the disk cannot."""
        with suppress(ValueError):
            number = self._handle()
            if number is None:
                return
            # A descriptor of our own: the writer may close its file meanwhile.
            own = os.dup(number)
            try:
                os.fdatasync(own)
            finally:
                os.close(own)
