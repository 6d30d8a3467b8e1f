"""The writer of a take: queues raw pairs and writes them from a thread of its own.

    writing <--> interrupted      the disk is full, gone or broken; with ``retry_s`` the take resumes in a new part
       |             |            as soon as possible, else it has failed
       +-> closed <--+-> failed

The disk never delays the measuring: a full queue, a full disk or an error is counted and reported in the status.
"""

from __future__ import annotations

import json
import logging
import shutil
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

from daemon.common.errors import DaemonError
from daemon.live.items import CloudItem, Item, Pair
from daemon.recording.format.errors import TakeError
from daemon.recording.format.part_names import CALIBRATION, PATTERN, RIG, VOLUME
from daemon.recording.format.raw_image import ImageError
from daemon.recording.write.disk_space import DiskGuard
from daemon.recording.write.disk_sync import DiskSync, Policy
from daemon.recording.write.frame_queue import FrameQueue, RawItem
from daemon.recording.write.part_chain import Limits, PartChain
from daemon.recording.write.part_writer import PartWriter
from daemon.recording.write.progress import Progress
from drivers.protocols import Frame

CLOSE_S = 30.0
HUNG_S = 5.0
log = logging.getLogger("fringed.recorder")


class _DiskFullError(Exception):
    """The free space has reached its limit; no write has failed."""


class TakeWriter:
    """A sink that writes a take; its first file exists when the constructor returns.

    Args:
        path: ``NAME.mcap``; further parts are ``NAME_part002.mcap`` and so on.
        session: unique text; device: name of the rig.
        calibration_data: the calibration file byte for byte; pattern, volume: JSON objects; rig_data: rig.yaml, if any.
        queue: items that wait for the disk; compression: ``none``, ``lz4`` or ``zstd``.
        max_part_bytes, max_part_s: size and duration at which a new part begins.
        min_free_bytes: free space that must stay.
        retry_s: how often an interrupted take tries to resume; None: the first error ends it.
        sync: when the file is synchronised with the disk, see :class:`DiskSync`.
        endless: remove the oldest parts instead of ending for lack of room; keep_bytes, keep_s: see :class:`Limits`.
        tolerance_ns: how far the exposures of a pair may lie apart.
        extra_metadata: more keys of the record ``fringed``; free_bytes: returns the free space of a directory.

    Raises:
        OSError: the file cannot be created. DaemonError: there is too little free space to begin.
    """

    heartbeat = None

    def __init__(
        self,
        path: Path,
        *,
        session: str,
        device: str,
        calibration_data: bytes,
        pattern: Mapping[str, Any],
        volume: Mapping[str, Any],
        rig_data: bytes | None = None,
        queue: int = 16,
        max_part_bytes: int = 2048 << 20,
        max_part_s: float = 600.0,
        min_free_bytes: int = 1024 << 20,
        retry_s: float | None = None,
        sync: Policy = "1s",
        endless: bool = False,
        keep_bytes: int = 0,
        keep_s: float = 0.0,
        tolerance_ns: int = 2_000_000,
        compression: str = "none",
        extra_metadata: Mapping[str, str] | None = None,
        free_bytes: Callable[[Path], int] = lambda directory: shutil.disk_usage(directory).free,
        open_part: Callable[..., PartWriter] = PartWriter,
    ) -> None:
        self._path, self._capacity, self._retry_s = Path(path), queue, retry_s
        attachments = {CALIBRATION: calibration_data, PATTERN: _json(pattern), VOLUME: _json(volume)}
        if rig_data is not None:
            attachments[RIG] = rig_data
        self._queue = FrameQueue(queue)
        self._interrupted = False
        self._progress = Progress()
        self._sync_error: OSError | None = None
        self._busy_ns = 0
        self._space = DiskGuard(self._path.parent, min_free_bytes, free_bytes)
        if (problem := self._space.problem()) is not None:
            raise DaemonError(problem)
        self._chain = PartChain(
            self._path,
            open_part=open_part,
            attachments=attachments,
            metadata=dict(extra_metadata or {}) | {"session": session, "device": device},
            compression=compression,
            limits=Limits(max_part_bytes, max_part_s, endless, keep_bytes, keep_s),
            tolerance_ns=tolerance_ns,
        )
        self._sync = DiskSync(
            self._chain.handle, self._sync_failed, written=lambda: self._progress.position, policy=sync
        )
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Queue a pair or an unpaired frame; False when the queue is full or the take has ended. Never blocks."""
        return isinstance(item, CloudItem) or self._queue.offer(item)

    def take_over(self, items: Iterable[RawItem]) -> None:
        """Write these first: items from before the take began, which are exempt from the queue's capacity."""
        self._queue.take_over(items)

    def status(self) -> dict[str, Any]:
        """Return counts, files and, if there is one, the ``problem``."""
        progress, chain = self._progress, self._chain
        status = {
            "recording": self._thread.is_alive() and not self._queue.closing and not progress.failed,
            "file": str(self._path),
            "files": list(chain.files),
            "parts": chain.opened,
            "queued": len(self._queue),
            "dropped": self._queue.drops(),
            "synced": self._sync.status(),
            **progress.status(),
        }
        if chain.removed:
            status |= {"removed_parts": chain.removed, "removed_bytes": chain.removed_bytes}
        problem = progress.problem or self._hanging()
        return status if problem is None else status | {"problem": problem}

    def _hanging(self) -> str | None:
        began_ns = self._busy_ns
        waited_s = max((time.monotonic_ns() - began_ns) / 1e9 if began_ns else 0.0, self._sync.busy_s())
        return f"{self._path.parent}: the disk has not answered for {waited_s:.0f} s" if waited_s > HUNG_S else None

    def close(self) -> None:
        """Write what is queued and finish the file; never raises, may be called twice."""
        self._queue.close()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._fail(f"{self._path}: the disk did not take the rest within {CLOSE_S:.0f} s")

    def _run(self) -> None:
        whole = True
        try:
            self._write_until_closed()
        except (OSError, TakeError) as error:
            whole = self._sync_error is None
            self._fail(f"{self._path}: recording ended: {error}")
        except _DiskFullError as guard:
            self._fail(str(guard))
        except Exception as error:  # no error here may end the measuring
            self._fail(f"{self._path}: recording ended by a defect: {error!r}")
        finally:
            self._end(whole=whole)
            self._sync.close()

    def _write_until_closed(self) -> None:
        while True:
            if self._interrupted and not self._resume():
                return
            item = self._queue.next()
            if item is None:
                self._finish()
                return
            try:
                self._write(item)
            except (OSError, TakeError, _DiskFullError) as error:
                if self._retry_s is None:
                    self._queue.drop("failed")
                    raise
                self._interrupt(item, error)

    def _write(self, item: RawItem) -> None:
        if self._sync_error is not None:
            raise self._sync_error
        frames = _frames(item)
        size = sum(frame.image.nbytes for frame in frames)
        self._busy_ns = time.monotonic_ns()
        try:
            self._make_room(size)
            if self._chain.rotate(size, frames[0].t_host_ns):
                self._sync.set_synced(self._progress.position)
            self._write_frames(frames)
            if self._sync.policy == "chunk":
                self._sync_now()
        finally:
            self._busy_ns = 0

    def _sync_now(self) -> None:
        try:
            self._sync.sync()
        except OSError as error:  # the frame is written; the part is ended at the next one
            self._sync_failed(error)

    def _make_room(self, size: int) -> None:
        while (problem := self._space.problem(size)) is not None:
            if not self._chain.remove_oldest():
                raise _DiskFullError(problem)

    def _write_frames(self, frames: tuple[Frame, ...]) -> None:
        refused = self._chain.refusal(frames)
        if refused is not None:
            self._queue.drop(refused)
            return
        try:
            size = self._chain.write(frames)
        except ImageError as error:
            log.warning("not recorded: %s", error)
            self._queue.drop("refused")
            return
        self._progress.wrote(frames, size)

    def _interrupt(self, item: RawItem, error: Exception) -> None:
        """Close the part after a disk error if possible, keep the waiting items, and retry later."""
        problem = str(error) if isinstance(error, _DiskFullError) else f"{self._path.parent}: {error}"
        log.warning("recording is interrupted: %s", problem)
        self._queue.put_back(item)
        self._queue.set_disk_missing(True)
        self._progress.interrupted(problem)
        self._interrupted = True
        self._close_part(whole=self._sync_error is None)

    def _resume(self) -> bool:
        """Wait for the disk and open a new part; False when the take is closed without one."""
        while True:
            closing = self._queue.closing
            self._queue.pause(self._retry_s or 0.0)
            self._busy_ns = time.monotonic_ns()
            try:
                problem = self._try_resume()
            except OSError as error:
                problem = f"{self._path.parent}: {error}"
            finally:
                self._busy_ns = 0
            self._progress.problem, self._interrupted = problem, problem is not None
            if problem is None:
                self._queue.set_disk_missing(False)
                log.info("recording resumes in %s", self._chain.files[-1])
                return True
            if closing:
                return False

    def _try_resume(self) -> str | None:
        waiting = self._queue.first()
        size = 0 if waiting is None else sum(frame.image.nbytes for frame in _frames(waiting))
        problem = self._space.problem_if_replaced(self._chain.newest_files())
        if problem is not None:
            return problem
        while (problem := self._space.problem_to_resume(size)) is not None:
            if not self._chain.remove_oldest():
                return problem
        self._chain.begin(continues=self._chain.last_name)
        self._sync_error = None
        return None

    def _finish(self) -> None:
        self._busy_ns = time.monotonic_ns()
        try:
            self._chain.finish()
        finally:
            self._busy_ns = 0
        self._sync.set_synced(self._progress.position)

    def _close_part(self, *, whole: bool) -> None:
        if self._chain.part is None:
            return
        if self._chain.end_after_error(whole=whole):
            self._sync.set_synced(self._progress.position)
        else:
            self._progress.count_unsynced(self._sync.synced)

    def _end(self, *, whole: bool) -> None:
        """Close the part if possible and count the items that were not written."""
        self._close_part(whole=whole)
        self._queue.clear("failed")

    def _sync_failed(self, error: OSError) -> None:
        """Keep an error of the synchronisation; the writing thread then ends the part."""
        self._sync_error = error

    def _fail(self, problem: str) -> None:
        self._queue.refuse("failed")
        self._progress.fail(problem)


def _frames(item: RawItem) -> tuple[Frame, ...]:
    return (item.left, item.right) if isinstance(item, Pair) else (item.frame,)


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(dict(value)).encode()
