"""Give a file that was cut off or damaged its end again: everything that is sound goes into a new file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from daemon.common.files import sync_directory
from daemon.recording.format.errors import TakeError
from daemon.recording.format.file_lock import being_written
from daemon.recording.format.part_names import PARTIAL
from daemon.recording.read.part_reader import PartReader
from daemon.recording.write.part_writer import PartWriter
from drivers.protocols import Frame

BROKEN = ".broken"


@dataclass(frozen=True, slots=True)
class Repaired:
    """What became of a file.

    Args:
        file: the sound one; kept: what was there before, under another name; frames: saved; problems: that it had.
    """

    file: Path
    kept: Path
    frames: int
    problems: list[str]


def repair(path: Path, progress: Callable[[int, int], Any] | None = None) -> Repaired | None:
    """Repair one file of a take; None if nothing is wrong with it.

    Args:
        progress: told bytes read and bytes in all.

    Raises:
        TakeError: the file is being written, is none of ours, or its new name is taken. OSError: the disk is full.
    """
    if being_written(path):
        raise TakeError(f"{path}: it is being written; stop the recording first")
    final = path.with_name(path.name.removesuffix(PARTIAL))
    kept = path.with_name(final.name + BROKEN)
    part = PartReader(path)
    try:
        frames = sum(1 for _ in part.frames())
        if not part.problems:
            return _named(path, final, frames)
        for name in (kept, *([final] if final != path else [])):
            if name.exists():
                raise TakeError(f"{path}: {name} is there already; move it away first")
        fresh = _copied(part, final, progress)
    finally:
        part.close()
    path.rename(kept)
    fresh.rename(final)
    sync_directory(path.parent)
    return Repaired(final, kept, frames, part.problems)


def _named(path: Path, final: Path, frames: int) -> Repaired | None:
    """Give a file that is whole its final name, which a crash may have kept from it."""
    if path == final:
        return None
    if final.exists():
        raise TakeError(f"{path}: {final} is there already; move it away first")
    path.rename(final)
    sync_directory(final.parent)
    return Repaired(final, final, frames, ["only the name was missing"])


def _copied(part: PartReader, final: Path, progress: Callable[[int, int], Any] | None) -> Path:
    """A new file beside the old one, with everything that is sound, frames that were written together still so."""
    fresh = final.with_name(f".{final.name}.repairing")
    for left_behind in (fresh, fresh.with_name(fresh.name + PARTIAL)):
        left_behind.unlink(missing_ok=True)
    out = PartWriter(fresh, attachments=part.attachments, metadata=part.metadata, created_ns=time.time_ns())
    try:
        for offset, frames in _chunks(part):
            out.write(*frames)
            if progress is not None:
                progress(offset, part.survey.size)
        out.finish()
    except BaseException:
        out.abandon()
        with suppress(OSError):
            out.partial.unlink()
        raise
    return fresh


def _chunks(part: PartReader) -> Iterator[tuple[int, list[Frame]]]:
    for offset, rows in groupby(part.frames(), key=lambda row: row[1].place.offset):
        yield offset, [frame for frame, _ in rows]
