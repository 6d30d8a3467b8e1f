"""The sequence of a take's parts: opened, filled, finished and, in an endless recording, removed."""

from __future__ import annotations

import errno
import logging
import os
import time
from collections import deque
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from daemon.recording.format.part_names import part_path
from daemon.recording.write.part_writer import PartWriter
from daemon.recording.write.trigger_ledger import TriggerLedger
from drivers.protocols import Frame

log = logging.getLogger("fringed.recorder")

_TRIES = 100
_LISTED_FILES = 16


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of a part, and of what an endless recording keeps.

    Args:
        part_bytes, part_s: size and duration of a part.
        endless: remove the oldest parts, beyond ``keep_bytes`` or ``keep_s`` (0: no limit but the disk).
    """

    part_bytes: int = 2048 << 20
    part_s: float = 600.0
    endless: bool = False
    keep_bytes: int = 0
    keep_s: float = 0.0


@dataclass(frozen=True, slots=True)
class _Finished:
    path: Path
    size: int
    ended_ns: int


class PartChain:
    """The parts of a take; owned by the writing thread, any may read ``files``, ``removed`` and ``removed_bytes``.

    Args:
        path: of the first part; open_part: makes a :class:`PartWriter`.
        attachments, metadata: of every part; tolerance_ns: of the exposures of a pair.
    """

    def __init__(
        self,
        path: Path,
        *,
        open_part: Callable[..., PartWriter],
        attachments: Mapping[str, bytes],
        metadata: Mapping[str, str],
        compression: str,
        limits: Limits,
        tolerance_ns: int,
    ) -> None:
        self._path, self._open_part, self._limits = path, open_part, limits
        self._attachments, self._metadata, self._compression = attachments, metadata, compression
        self._ledger = TriggerLedger(tolerance_ns)
        self._number = self._frames = self._began_ns = self._now_ns = 0
        self._finished: deque[_Finished] = deque()
        self.part: PartWriter | None = None
        self.files: tuple[str, ...] = ()
        self.opened = self.removed = self.removed_bytes = 0
        self.begin()

    def begin(self, continues: str = "") -> None:
        """Open the next part; ``continues`` names the one that was interrupted."""
        extra = {"continues": continues} if continues else {}
        first = self._number + 1
        for number in range(first, first + _TRIES):
            try:
                part = self._open_part(
                    part_path(self._path, number),
                    attachments=self._attachments,
                    metadata={**self._metadata, "part": str(number), **extra},
                    created_ns=time.time_ns(),
                    compression=self._compression,
                )
                break
            except FileExistsError:
                if number == 1:
                    raise
        else:
            raise FileExistsError(errno.EEXIST, "a hundred parts of this name exist", str(self._path))
        self.part, self._number, self._frames = part, number, 0
        self.opened += 1
        self.files = (*self.files[1 - _LISTED_FILES :], str(part.partial))

    def handle(self) -> int | None:
        """Return the descriptor of the open part; None or ValueError while there is none."""
        part = self.part
        return None if part is None else part.handle

    def newest_files(self) -> list[Path]:
        """Return the newest files of the take."""
        return [Path(file) for file in self.files]

    def refusal(self, frames: tuple[Frame, ...]) -> str | None:
        """Return why these frames must not be written, see :class:`TriggerLedger`."""
        return self._ledger.refusal(frames, self._number)

    def write(self, frames: tuple[Frame, ...]) -> int:
        """Write frames that belong together into one part; return the bytes written."""
        part = self.part
        if part is None:
            raise OSError(errno.EIO, "no part is open", str(self._path))
        before = part.size
        part.write(*frames)
        if self._frames == 0:
            self._began_ns = frames[0].t_host_ns
        self._frames += 1
        self._now_ns = max(self._now_ns, frames[0].t_host_ns)
        self._ledger.wrote(frames, self._number)
        return part.size - before

    def rotate(self, size: int, t_ns: int) -> bool:
        """Begin a new part if this one has reached its limits; return whether it did."""
        part = self.part
        if part is None or self._frames == 0:
            return False
        too_large = part.size + size > self._limits.part_bytes
        # A clock that was set back must not make a part that never ends.
        too_long = abs(t_ns - self._began_ns) > 1e9 * self._limits.part_s
        if too_large or too_long:
            self.finish()
            self.begin()
            self._prune()
        return too_large or too_long

    def finish(self) -> None:
        """End the part now, if there is one."""
        part = self.part
        if part is None:
            return
        part.finish()
        self.part = None
        self.files = (*self.files[:-1], str(part.path))
        self._finished.append(_Finished(part.path, part.size, self._now_ns))

    @property
    def last_name(self) -> str:
        """Name of the newest file."""
        return Path(self.files[-1]).name if self.files else ""

    def end_after_error(self, *, whole: bool) -> bool:
        """Finish the part after an error if the disk permits, else abandon it; return whether it was finished.

        Args:
            whole: False when the disk did not keep what was written; the part then gets no index.
        """
        part = self.part
        if part is None:
            return True
        try:
            if not whole:
                raise OSError(errno.EIO, "not all of it is on the disk")
            self.finish()
        except (OSError, ValueError) as error:
            self._abandon(part, error)
            return False
        return True

    def _abandon(self, part: PartWriter, error: Exception) -> None:
        self.part = None
        part.abandon()
        if self._frames:
            log.warning("%s stays unfinished, up to its last whole pair it can be read: %s", part.partial, error)
        elif self.opened > 1:
            with suppress(OSError):  # nothing is in it
                part.partial.unlink()
                self.files = self.files[:-1]

    def _prune(self) -> None:
        """Remove the oldest parts beyond what an endless recording keeps."""
        limits = self._limits
        while limits.endless and self._finished:
            oldest = self._finished[0]
            total = sum(part.size for part in self._finished) + limits.part_bytes
            too_much = limits.keep_bytes and total > limits.keep_bytes
            too_old = limits.keep_s and self._now_ns - oldest.ended_ns > 1e9 * limits.keep_s
            if not (too_much or too_old) or not self.remove_oldest():
                return

    def remove_oldest(self) -> bool:
        """Remove the oldest finished part of an endless recording; False when there is none."""
        if not (self._limits.endless and self._finished):
            return False
        oldest = self._finished.popleft()
        try:
            os.unlink(oldest.path)  # noqa: PTH108 - as all of the recorder's work on the disk
        except FileNotFoundError:
            return True
        except OSError as error:
            log.warning("%s cannot be removed: %s", oldest.path, error)
            return False
        self.removed += 1
        self.removed_bytes += oldest.size
        self.files = tuple(file for file in self.files if file != str(oldest.path))
        return True
