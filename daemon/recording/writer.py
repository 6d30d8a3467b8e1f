"""The recorder: takes raw pairs into a bounded queue and writes them from a thread of its own.

Whatever the disk does, the measuring goes on: a full queue, a full disk or an error is counted and told in the status.
"""

from __future__ import annotations

import json
import logging
import shutil
import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.errors import DaemonError
from daemon.recording.errors import TakeError
from daemon.recording.part_writer import PartWriter
from daemon.recording.parts import CALIBRATION, PATTERN, RIG, VOLUME, part_path
from daemon.recording.raw_image import ImageError
from daemon.recording.syncer import Syncer
from daemon.sinks import CloudItem, Item, LoneItem, PairItem
from drivers.protocols import Frame

CLOSE_S = 30.0
log = logging.getLogger("fringed.recorder")

# Index and footer of a part must still fit when the guard ends a take.
_CLOSING_BYTES = 1 << 20


@dataclass(slots=True)
class _State:
    pairs: int = 0
    lone_frames: int = 0
    written_bytes: int = 0
    files: list[str] = field(default_factory=list)
    dropped: Counter[str] = field(default_factory=Counter)
    problem: str | None = None


class TakeWriter:
    """A sink that writes a take; the first file exists when the constructor returns.

    Args:
        path: ``NAME.mcap``; further parts are ``NAME_part002.mcap`` and so on.
        session: unique text; device: name of the rig.
        calibration_data: the calibration file byte for byte; pattern, volume: JSON objects; rig_data: rig.yaml, if any.
        queue: items that wait for the disk; compression: ``none``, ``lz4`` or ``zstd``.
        max_part_bytes, max_part_s: size and duration at which a new part begins.
        min_free_bytes: free space at which the take ends.
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
        compression: str = "none",
        extra_metadata: Mapping[str, str] | None = None,
        free_bytes: Callable[[Path], int] = lambda directory: shutil.disk_usage(directory).free,
        open_part: Callable[..., PartWriter] = PartWriter,
    ) -> None:
        self._path, self._free_bytes, self._open_part = Path(path), free_bytes, open_part
        self._capacity, self._max_part_bytes, self._min_free_bytes = queue, max_part_bytes, min_free_bytes
        self._max_part_ns, self._part_began_ns = round(1e9 * max_part_s), 0
        self._compression = compression
        self._attachments = {CALIBRATION: calibration_data, PATTERN: _json(pattern), VOLUME: _json(volume)}
        if rig_data is not None:
            self._attachments[RIG] = rig_data
        self._metadata = dict(extra_metadata or {}) | {"session": session, "device": device}
        self._queue: deque[PairItem | LoneItem] = deque()
        self._changed = threading.Condition()
        self._closing = False
        self._state = _State()
        self._parts_begun = 0
        if (problem := self._space_problem(0)) is not None:
            raise DaemonError(problem)
        self._part: PartWriter | None = self._new_part()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._sync_error: OSError | None = None
        self._syncer = Syncer(self._handle, self._cannot_sync)
        self._thread.start()

    def offer(self, item: Item) -> bool:
        """Take a pair or a lone frame; False when the queue is full or the take has ended. Never blocks."""
        if isinstance(item, CloudItem):
            return True
        with self._changed:
            reason = self._refusal()
            if reason is not None:
                self._state.dropped[reason] += 1
                return False
            self._queue.append(item)
            self._changed.notify()
            return True

    def _refusal(self) -> str | None:
        if self._state.problem is not None:
            return "failed"
        if self._closing:
            return "closed"
        return "queue_full" if len(self._queue) >= self._capacity else None

    def status(self) -> dict[str, Any]:
        """Counts, files and, if anything is wrong, the ``problem``."""
        with self._changed:
            state = self._state
            status: dict[str, Any] = {
                "recording": self._part is not None and not self._closing,
                "file": str(self._path),
                "files": list(state.files),
                "pairs": state.pairs,
                "lone_frames": state.lone_frames,
                "bytes": state.written_bytes,
                "queued": len(self._queue),
                "dropped": dict(state.dropped),
            }
            return status if state.problem is None else status | {"problem": state.problem}

    def close(self) -> None:
        """Write what is queued and finish the file; never raises, may be called twice."""
        with self._changed:
            self._closing = True
            self._changed.notify()
        self._thread.join(CLOSE_S)
        if self._thread.is_alive():
            self._fail(f"{self._path}: the disk did not take the rest within {CLOSE_S:.0f} s")

    def _run(self) -> None:
        try:
            self._write_until_closed()
        except (OSError, TakeError) as error:
            self._fail(f"{self._path}: recording ended: {error}")
        except Exception as error:  # the measuring must go on whatever happens here
            self._fail(f"{self._path}: recording ended by a defect: {error!r}")
        finally:
            self._let_go()
            self._syncer.close()

    def _write_until_closed(self) -> None:
        while (item := self._next()) is not None:
            if self._sync_error is not None:
                self._count_lost(1)
                raise self._sync_error
            self._write(item)
        self._finish_part()

    def _handle(self) -> int | None:
        part = self._part
        return None if part is None else part.handle

    def _cannot_sync(self, error: OSError) -> None:
        """Told by the syncer; the writing thread ends the take."""
        self._sync_error = error

    def _next(self) -> PairItem | LoneItem | None:
        """What is to be written next; None once everything is and the take is to end."""
        with self._changed:
            self._changed.wait_for(lambda: self._queue or self._closing)
            return self._queue.popleft() if self._queue else None

    def _write(self, item: PairItem | LoneItem) -> None:
        frames = (item.left, item.right) if isinstance(item, PairItem) else (item.frame,)
        size = sum(frame.image.nbytes for frame in frames)
        if (problem := self._space_problem(size)) is not None:
            # Ended while there is still room for the index: the file is whole.
            self._finish_part()
            self._fail(problem, 1)
            return
        part = self._part_for(size, frames[0].t_host_ns)
        if part is None:
            self._count_lost(1)
            return
        self._write_frames(part, frames)

    def _write_frames(self, part: PartWriter, frames: tuple[Frame, ...]) -> None:
        before = part.size
        try:
            part.write(*frames)
        except ImageError as error:
            log.warning("not recorded: %s", error)
            self._count_lost(1, "refused")
            return
        except BaseException:
            self._count_lost(1)
            raise
        with self._changed:
            self._state.written_bytes += part.size - before
            self._state.pairs += len(frames) == 2
            self._state.lone_frames += len(frames) == 1

    def _part_for(self, size: int, t_ns: int) -> PartWriter | None:
        """The part that takes the next frames; a new one when this one is large or long enough."""
        part = self._part
        if part is not None and self._frames_in_part > 0:
            too_large = part.size + size > self._max_part_bytes
            if too_large or t_ns - self._part_began_ns > self._max_part_ns:
                self._finish_part()
                part = self._part = self._new_part()
        if self._frames_in_part == 0:
            self._part_began_ns = t_ns
        self._frames_in_part += 1
        return part

    def _new_part(self) -> PartWriter:
        self._parts_begun += 1
        number = self._parts_begun
        part = self._open_part(
            part_path(self._path, number),
            attachments=self._attachments,
            metadata=self._metadata | {"part": str(number)},
            created_ns=time.time_ns(),
            compression=self._compression,
        )
        self._frames_in_part = 0
        with self._changed:
            self._state.files.append(str(part.partial))
        return part

    def _finish_part(self) -> None:
        part = self._part
        if part is None:
            return
        part.finish()
        with self._changed:
            self._part = None
            self._state.files[-1] = str(part.path)

    def _let_go(self) -> None:
        """After an error: end the file with what is in it if the disk lets us, and count what nobody will write."""
        part = self._part
        if part is not None:
            try:
                self._finish_part()
            except (OSError, ValueError) as error:
                log.warning("%s stays unfinished, up to its last whole pair it can be read: %s", part.partial, error)
                part.abandon()
        with self._changed:
            self._part = None
            lost = len(self._queue)
            self._queue.clear()
        self._count_lost(lost)

    def _space_problem(self, size: int) -> str | None:
        free = self._free_bytes(self._path.parent)
        if free - size >= max(self._min_free_bytes, _CLOSING_BYTES):
            return None
        return (
            f"{self._path.parent}: {free >> 20} MB free, recording needs {self._min_free_bytes >> 20} MB;"
            " make room or lower recording.min_free_mb"
        )

    def _count_lost(self, count: int, reason: str = "failed") -> None:
        if count:
            with self._changed:
                self._state.dropped[reason] += count

    def _fail(self, problem: str, lost: int = 0) -> None:
        with self._changed:
            if self._state.problem is None:
                self._state.problem = problem
        self._count_lost(lost)


def _json(value: Mapping[str, Any]) -> bytes:
    return json.dumps(dict(value)).encode()
