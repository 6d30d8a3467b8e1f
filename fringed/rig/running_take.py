"""A take that a daemon writes, from ``record()`` to ``stop()``."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Self

import msgspec

from fringed.protocol.status import Recorder


class RunningTake:
    """A take that is written; a ``with`` block stops it at its end.

    Args:
        call: of the daemon; name, before_s: as in ``record``.
    """

    def __init__(self, call: Callable[..., Any], name: str, before_s: float) -> None:
        self._call = call
        self._summary: Recorder | None = None
        #: Path of its first part on the daemon's machine.
        self.file: str = call("record.start", name=name, before_s=before_s)["file"]

    def stop(self) -> Recorder:
        """End the take and return its counts; it is complete on the disk. May be called twice."""
        if self._summary is None:
            self._summary = msgspec.convert(self._call("record.stop"), Recorder)
        return self._summary

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
