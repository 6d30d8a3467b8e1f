"""The recorder: takes raw pairs into a bounded queue and writes them from a thread of its own.

    writing <--> interrupted      the disk is full, gone or broken; with ``retry_s`` the take goes on in a new part
       |             |            as soon as it can, else it has failed
       +-> closed <--+-> failed

Whatever the disk does, the measuring goes on: a full queue, a full disk or an error is counted and told in the status.
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
from daemon.live.items import CloudItem, Item, PairItem
from daemon.recording.format.errors import TakeError
from daemon.recording.format.part_names import CALIBRATION, PATTERN, RIG, VOLUME
from daemon.recording.format.raw_image import ImageError
from daemon.recording.write.disk_space import Disk
from daemon.recording.write.disk_sync import Policy, Syncer
from daemon.recording.write.frame_queue import Image, Inbox
from daemon.recording.write.part_chain import Limits, PartChain
from daemon.recording.write.part_writer import PartWriter
from daemon.recording.write.progress import Progress
from drivers.protocols import Frame

CLOSE_S = 30.0
HANGS_S = 5.0
log = logging.getLogger("fringed.recorder")


class _NoRoomError(Exception):
    """The guard says so: nothing went wrong yet."""


class TakeWriter:
    """A sink that writes a take; the first file exists when the constructor returns.

    Args:
        path: ``NAME.mcap``; further parts are ``NAME_part002.mcap`` and so on.
        session: unique text; device: name of the rig.
        calibration_data: the calibration file byte for byte; pattern, volume: JSON objects; rig_data: rig.yaml, if any.
        queue: items that wait for the disk; compression: ``none``, ``lz4`` or ``zstd``.
        max_part_bytes, max_part_s: size and duration at which a new part begins.
        min_free_bytes: free space that must stay.
        retry_s: how often an interrupted take tries to go on; None: the first trouble ends it.
        sync: when what is written is brought to the disk, see :class:`Syncer`.
        endless: remove the oldest parts instead of ending for lack of room; keep_bytes, keep_s: see :class:`Limits`.
        tolerance_ns: how far the exposures of a pair may lie apart.
        extra_metadata: more keys of the record ``fringed``; free_bytes: free space of a directory.

    Raises:
        OSError: the file cannot be made. DaemonError: there is too little free space to begin.
    """

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
        self._inbox = Inbox(queue)
        self._interrupted = False
        self._progress = Progress()
        self._sync_error: OSError | None = None
        self._busy_ns = 0
        self._disk = Disk(self._path.parent, min_free_bytes, free_bytes)
        if (problem := self._disk.problem()) is not None:
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
        self._syncer = Syncer(self._chain.handle, self._cannot_sync, written=lambda: self._progress.mark, policy=sync)
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Take a pair or a lone frame; False when the queue is full or the take has ended. Never blocks."""
        return isinstance(item, CloudItem) or self._inbox.offer(item)

    def take_over(self, items: Iterable[Image]) -> None:
        """Write these first: what came before the take began. They need not fit into the queue."""
        self._inbox.take_over(items)

    def status(self) -> dict[str, Any]:
        """Counts, files and, if anything is wrong, the ``problem``."""
        progress, chain = self._progress, self._chain
        status = {
            "recording": self._thread.is_alive() and not self._inbox.closing and not progress.failed,
            "file": str(self._path),
            "files": list(chain.files),
            "parts": chain.begun,
            "queued": len(self._inbox),
            "dropped": self._inbox.drops(),
            "synced": self._syncer.status(),
            **progress.status(),
        }
        if chain.removed:
            status |= {"removed_parts": chain.removed, "removed_bytes": chain.removed_bytes}
        problem = progress.problem or self._hanging()
        return status if problem is None else status | {"problem": problem}

    def _hanging(self) -> str | None:
        began_ns = self._busy_ns
        waited_s = max((time.monotonic_ns() - began_ns) / 1e9 if began_ns else 0.0, self._syncer.busy_s())
        return f"{self._path.parent}: the disk has not answered for {waited_s:.0f} s" if waited_s > HANGS_S else None

    def close(self) -> None:
        """Write what is queued and finish the file; never raises, may be called twice."""
        self._inbox.close()
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
        except _NoRoomError as guard:
            self._fail(str(guard))
        except Exception as error:  # the measuring must go on whatever happens here
            self._fail(f"{self._path}: recording ended by a defect: {error!r}")
        finally:
            self._let_go(whole=whole)
            self._syncer.close()

    def _write_until_closed(self) -> None:
        while True:
            if self._interrupted and not self._goes_on():
                return
            item = self._inbox.next()
            if item is None:
                self._finish()
                return
            try:
                self._write(item)
            except (OSError, TakeError, _NoRoomError) as error:
                if self._retry_s is None:
                    self._inbox.drop("failed")
                    raise
                self._interrupt(item, error)

    def _write(self, item: Image) -> None:
        if self._sync_error is not None:
            raise self._sync_error
        frames = _frames(item)
        size = sum(frame.image.nbytes for frame in frames)
        self._busy_ns = time.monotonic_ns()
        try:
            self._make_room(size)
            if self._chain.rotate(size, frames[0].t_host_ns):
                self._syncer.all_is(self._progress.mark)
            self._write_frames(frames)
            if self._syncer.policy == "chunk":
                self._sync_now()
        finally:
            self._busy_ns = 0

    def _sync_now(self) -> None:
        try:
            self._syncer.sync()
        except OSError as error:  # the frame is written; the next one finds the part gone
            self._cannot_sync(error)

    def _make_room(self, size: int) -> None:
        while (problem := self._disk.problem(size)) is not None:
            if not self._chain.remove_oldest():
                raise _NoRoomError(problem)

    def _write_frames(self, frames: tuple[Frame, ...]) -> None:
        refused = self._chain.refusal(frames)
        if refused is not None:
            self._inbox.drop(refused)
            return
        try:
            size = self._chain.write(frames)
        except ImageError as error:
            log.warning("not recorded: %s", error)
            self._inbox.drop("refused")
            return
        self._progress.wrote(frames, size)

    def _interrupt(self, item: Image, error: Exception) -> None:
        """The disk is full or in trouble: close the part as well as can be, keep what waits, and try again later."""
        trouble = str(error) if isinstance(error, _NoRoomError) else f"{self._path.parent}: {error}"
        log.warning("recording is interrupted: %s", trouble)
        self._inbox.put_back(item)
        self._inbox.no_disk(True)
        self._progress.interrupted(trouble)
        self._interrupted = True
        self._close_part(whole=self._sync_error is None)

    def _goes_on(self) -> bool:
        """Wait for the disk and open a new part; False when the take is to end without."""
        while True:
            closing = self._inbox.closing
            self._inbox.pause(self._retry_s or 0.0)
            self._busy_ns = time.monotonic_ns()
            try:
                problem = self._resumed()
            except OSError as error:
                problem = f"{self._path.parent}: {error}"
            finally:
                self._busy_ns = 0
            self._progress.problem, self._interrupted = problem, problem is not None
            if problem is None:
                self._inbox.no_disk(False)
                log.info("recording goes on in %s", self._chain.files[-1])
                return True
            if closing:
                return False

    def _resumed(self) -> str | None:
        waits = self._inbox.first()
        size = 0 if waits is None else sum(frame.image.nbytes for frame in _frames(waits))
        problem = self._disk.is_another(self._chain.known())
        if problem is not None:
            return problem
        while (problem := self._disk.problem_to_go_on(size)) is not None:
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
        self._syncer.all_is(self._progress.mark)

    def _close_part(self, *, whole: bool) -> None:
        if self._chain.part is None:
            return
        if self._chain.let_go(whole=whole):
            self._syncer.all_is(self._progress.mark)
        else:
            self._progress.unsure(self._syncer.synced)

    def _let_go(self, *, whole: bool) -> None:
        """The end: the part as well as can be, and a count of what nobody will write."""
        self._close_part(whole=whole)
        self._inbox.clear("failed")

    def _cannot_sync(self, error: OSError) -> None:
        """Told by the syncer; the writing thread ends the part."""
        self._sync_error = error

    def _fail(self, problem: str) -> None:
        self._inbox.refuse("failed")
        self._progress.fail(problem)


def _frames(item: Image) -> tuple[Frame, ...]:
    return (item.left, item.right) if isinstance(item, PairItem) else (item.frame,)


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(dict(value)).encode()
