"""The recording switch of a running daemon: one take at a time, a sink like any other while it runs."""

from __future__ import annotations

import threading
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from daemon.errors import DaemonError
from daemon.service import Service
from daemon.sinks import Sink

SINK = "recorder"


class Recorder:
    """Starts and stops takes.

    Args:
        service: whose pairs are recorded.
        directory: of the takes, as it is when one begins; made then.
        open_take: makes the writer of a take from its path; the path's end is the take's to choose.
    """

    def __init__(
        self, service: Service, directory: Path | Callable[[], Path], open_take: Callable[[Path], Sink]
    ) -> None:
        self._service, self._directory, self._open_take = service, directory, open_take
        self._lock = threading.Lock()
        self._path: Path | None = None

    @property
    def recording(self) -> bool:
        """Whether a take is being written."""
        return self._path is not None

    def start(self, name: str) -> dict[str, Any]:
        """Begin a take; its file is told.

        Raises:
            DaemonError: when one is being written already; OSError: when the directory cannot be written.
        """
        with self._lock:
            if self._path is not None:
                raise DaemonError(f"a take is being written already: {self._path}; stop it first")
            directory = self._directory if isinstance(self._directory, Path) else self._directory()
            directory.mkdir(parents=True, exist_ok=True)
            stamp = datetime.fromtimestamp(self._service.clock.realtime_ns() / 1e9, tz=UTC)
            path = directory / f"{name}_{stamp:%Y%m%dT%H%M%S}_{stamp.microsecond // 1000:03d}.mcap"
            if path.exists():
                raise DaemonError(f"{path} exists already; try again")
            self._service.add_sink(SINK, self._open_take(path))
            self._path = path
            return {"recording": True, "file": str(path)}

    def stop(self) -> dict[str, Any]:
        """End the take; returns when it is whole on the disk."""
        with self._lock:
            sink = self._service.remove_sink(SINK)
            path, self._path = self._path, None
            if sink is None:
                return {"recording": False}
            sink.close()
            return {"file": str(path), **sink.status(), "recording": False}
