"""The recorder of a running daemon: a sink that buffers the last seconds and passes items on to one take at a time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol

from daemon.common.errors import DaemonError
from daemon.config.rig_config import RigConfig
from daemon.live.items import CloudItem, Item, Sink
from daemon.live.router import Router
from daemon.recording.read.catalog import Listing, scan
from daemon.recording.write.frame_queue import RawItem
from daemon.recording.write.pretrigger_buffer import MEGABYTE, PretriggerBuffer
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock

SINK = "recorder"
MOST_TAKES, MOST_OTHER_FILES = 1000, 100
"""The newest takes and the other files that are listed over the control socket."""


class Take(Sink, Protocol):
    """A take that is being written."""

    def take_over(self, items: Iterable[RawItem]) -> None:
        """Write these items first."""


class Recorder:
    """Starts and stops takes; a sink of the service from the beginning.

    Args:
        router: whose pairs are recorded; config: at the start.
        directory: of the takes, as it is when one begins; created then.
        open_take: makes the writer of a take from its path.
    """

    heartbeat = None

    def __init__(
        self,
        router: Router,
        config: RigConfig,
        directory: Path | Callable[[], Path],
        open_take: Callable[[Path], Any],
        *,
        clock: Clock,
    ) -> None:
        self._config, self._directory, self._open_take, self._clock = config, directory, open_take, clock
        self._switch = threading.Lock()  # held while a take begins or ends, which may take long
        self._routing = threading.Lock()  # held briefly: guards which buffer or take gets an item
        self._path: Path | None = None
        self._take: Take | None = None
        self._pretrigger = PretriggerBuffer(self._limits, clock.monotonic_ns)
        router.add_sink(SINK, self)

    @property
    def directory(self) -> Path:
        """Directory of the takes, as it is now."""
        return self._directory if isinstance(self._directory, Path) else self._directory()

    @property
    def recording(self) -> bool:
        """Whether a take is open."""
        return self._path is not None

    def start(self, name: str, before_s: float = 0.0) -> dict[str, Any]:
        """Begin a take; return its file and the number of items from before that it begins with.

        Args:
            before_s: begin this long before now, as far as ``recording.before_s`` kept it.

        Raises:
            DaemonError: a take is being written already, the directory cannot be written, or nothing was kept.
        """
        kept_s = self._limits()[0]
        if before_s > kept_s:
            raise DaemonError(
                f"a take cannot begin {before_s:g} s ago: the daemon keeps {kept_s:g} s; raise recording.before_s"
            )
        with self._switch:
            if self._path is not None:
                raise DaemonError(f"a take is being written already: {self._path}; stop it first")
            path = self._new_path(name)
            take: Take = self._opened(path)
            with self._routing:
                early = self._pretrigger.last(before_s) if before_s > 0 else []
                if early:
                    take.take_over(early)
                self._take, self._path = take, path
            return {"recording": True, "file": str(path), "before_items": len(early)}

    def _new_path(self, name: str) -> Path:
        directory = self.directory
        try:
            directory.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise DaemonError(
                f"{directory}: cannot be created: {error.strerror or error}; set recording.dir"
            ) from error
        stamp = datetime.fromtimestamp(self._clock.realtime_ns() / 1e9, tz=UTC)
        path = directory / f"{name}_{stamp:%Y%m%dT%H%M%S}_{stamp.microsecond // 1000:03d}.mcap"
        if path.exists():
            raise DaemonError(f"{path} exists already; try again")
        return path

    def _opened(self, path: Path) -> Any:
        try:
            return self._open_take(path)
        except OSError as error:
            raise DaemonError(
                f"{error.filename or path}: cannot be written: {error.strerror or error}; "
                "correct the directory's permissions or set recording.dir"
            ) from error

    def stop(self) -> dict[str, Any]:
        """End the take; return when it is complete on the disk."""
        with self._switch:
            with self._routing:
                take, self._take = self._take, None
            path, self._path = self._path, None
            if take is None:
                return {"recording": False}
            take.close()
            return {"file": str(path), **take.status(), "recording": False}

    def takes(self) -> dict[str, Any]:
        """List the takes of the directory and its other files; may read from a slow disk."""
        directory = self.directory
        listing = scan(directory) if directory.is_dir() else Listing()
        return {
            "directory": str(directory),
            "takes": [take.brief() for take in listing.takes[-MOST_TAKES:]],
            "garbage": dict(list(listing.other_files.items())[:MOST_OTHER_FILES]),
        }

    def offer(self, item: Item) -> bool:
        """Buffer an item and pass it on to the take; False when the take refuses it. Never blocks."""
        if isinstance(item, CloudItem):
            return True
        with self._routing:
            self._pretrigger.add(item)
            return self._take is None or self._take.offer(item)

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:  # noqa: ARG002 - the protocol's
        """Prepare to clear the buffer with the mode: its images show a pattern that no take will have."""

        def commit() -> None:
            before, self._config = self._config, config
            if config.mode != before.mode:
                with self._routing:
                    self._pretrigger.clear()

        return commit

    def close(self) -> None:
        """End the take, if there is one, and clear the buffer."""
        self.stop()
        with self._routing:
            self._pretrigger.clear()

    def status(self) -> dict[str, Any]:
        """Return the take's status, ``recording: false`` without one, and the buffer's as ``before``."""
        with self._routing:
            take = self._take
            kept = {"before": self._pretrigger.status()} if self._limits()[0] > 0 else {}
        return {"recording": False, **(take.status() if take is not None else {}), **kept}

    def _limits(self) -> tuple[float, int]:
        recording = self._config.recording
        return recording.before_s, recording.before_mb * MEGABYTE
