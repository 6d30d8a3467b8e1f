"""Repair of a cut or damaged file of a take: its undamaged frames are copied into a new, complete file."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from daemon.common.files import rename_without_replacing, sync_directory
from daemon.recording.format.errors import TakeError
from daemon.recording.format.file_lock import being_written
from daemon.recording.format.part_names import PARTIAL
from daemon.recording.read.part_reader import PartReader
from daemon.recording.write.part_writer import PartWriter
from drivers.protocols import Frame

BROKEN = ".broken"


@dataclass(frozen=True, slots=True)
class RepairResult:
    """Result of a repair.

    Args:
        file: the repaired one; kept: the damaged one under its new name; frames: number saved; problems: of the file.
    """

    file: Path
    kept: Path
    frames: int
    problems: list[str]


def repair(path: Path, progress: Callable[[int, int], Any] | None = None) -> RepairResult | None:
    """Repair one file of a take; None if nothing is wrong with it.

    Args:
        progress: called with bytes read and bytes in all.

    Raises:
        TakeError: the file is being written, is not a take, or its new name exists. OSError: the disk is full.
    """
    if being_written(path):
        raise TakeError(f"{path}: it is being written; stop the recording first")
    final = path.with_name(path.name.removesuffix(PARTIAL))
    kept = path.with_name(final.name + BROKEN)
    part = PartReader(path)
    try:
        frames = sum(1 for _ in part.frames())
        if not part.problems:
            return _rename_whole(path, final, frames)
        for name in (kept, *([final] if final != path else [])):
            if name.exists():
                raise TakeError(f"{path}: {name} exists already; move it away first")
        fresh = _copy_undamaged(part, final, progress)
    finally:
        part.close()
    _rename(path, kept)
    try:
        _rename(fresh, final)
    except BaseException:
        _rename(kept, path)
        fresh.unlink()
        raise
    sync_directory(path.parent)
    return RepairResult(final, kept, frames, part.problems)


def _rename_whole(path: Path, final: Path, frames: int) -> RepairResult | None:
    """Give a whole file its final name, which is missing after a crash between write and rename."""
    if path == final:
        return None
    _rename(path, final)
    sync_directory(final.parent)
    return RepairResult(final, final, frames, ["only the name was missing"])


def _rename(path: Path, target: Path) -> None:
    """Rename a file; one of the new name that appeared meanwhile is not replaced."""
    try:
        rename_without_replacing(path, target)
    except FileExistsError:
        raise TakeError(f"{path}: {target} exists already; move it away first") from None


def _copy_undamaged(part: PartReader, final: Path, progress: Callable[[int, int], Any] | None) -> Path:
    """Copy the undamaged frames into a new file beside the old one; frames of one chunk stay together."""
    fresh = final.with_name(f".{final.name}.repairing")
    for leftover in (fresh, fresh.with_name(fresh.name + PARTIAL)):
        leftover.unlink(missing_ok=True)
    out = PartWriter(fresh, attachments=part.attachments, metadata=part.metadata, created_ns=time.time_ns())
    try:
        for offset, frames in _chunks(part):
            out.write(*frames)
            if progress is not None:
                progress(offset, part.index.size)
        out.finish()
    except BaseException:
        out.abandon()
        with suppress(OSError):
            out.partial.unlink()
        raise
    return fresh


def _chunks(part: PartReader) -> Iterator[tuple[int, list[Frame]]]:
    for offset, rows in groupby(part.frames(), key=lambda row: row[1].chunk.offset):
        yield offset, [frame for frame, _ in rows]
