"""The takes of a directory, listed from the files' indexes without reading the images, and cached.

``takes.json`` in the directory caches the entries of finished files, by size and time of change; it may be removed at
any time, and files that do not match their entry are read again.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from daemon.common.files import write_atomically
from daemon.recording.format.errors import TakeError
from daemon.recording.format.file_lock import being_written
from daemon.recording.format.part_names import PARTIAL
from daemon.recording.read.part_reader import PartReader

CACHE = "takes.json"
_MAX_CACHE_BYTES = 16 << 20
_PART = re.compile(r"(?P<take>.+?)(?:_part(?P<number>\d{3,6}))?\.mcap")
_VERSION = 2


@dataclass(frozen=True, slots=True)
class FileEntry:
    """One file of a take; ``problem`` if it cannot be read or has no end."""

    name: str
    size: int
    mtime_ns: int
    problem: str = ""
    session: str = ""
    device: str = ""
    continues: str = ""
    left: int = 0
    right: int = 0
    first_ns: int = 0
    last_ns: int = 0


@dataclass(slots=True)
class TakeEntry:
    """A take: its files in order and their totals.

    Args:
        state: ``whole``, ``writing``, ``unfinished`` (a file has no end yet) or ``damaged``.
        frames: left, right; interruptions: parts that continue an interrupted one.
    """

    name: str
    state: str = "whole"
    files: list[str] = field(default_factory=list)
    bytes: int = 0
    frames: list[int] = field(default_factory=lambda: [0, 0])
    start_ns: int = 0
    end_ns: int = 0
    session: str = ""
    device: str = ""
    interruptions: int = 0
    problems: list[str] = field(default_factory=list)

    @property
    def duration_s(self) -> float:
        """From the first frame to the last."""
        return max(0, self.end_ns - self.start_ns) / 1e9

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self) | {"duration_s": round(self.duration_s, 3)}

    def brief(self) -> dict[str, Any]:
        """The same without the files' names, for messages of bounded size."""
        return self.as_dict() | {"files": len(self.files), "problems": [text[:200] for text in self.problems[:3]]}


@dataclass(slots=True)
class Listing:
    """The takes of a directory, oldest first, and files that are not takes, with the reason."""

    takes: list[TakeEntry] = field(default_factory=list)
    other_files: dict[str, str] = field(default_factory=dict)

    def find(self, name: str) -> TakeEntry:
        """Return the take of this name, or the only one whose name begins with it.

        Raises:
            TakeError: there is none, or there are several.
        """
        name = Path(name).name.removesuffix(PARTIAL).removesuffix(".mcap")
        matches = [take for take in self.takes if take.name == name]
        matches = matches or [take for take in self.takes if take.name.startswith(name)]
        if len(matches) == 1:
            return matches[0]
        names = ", ".join(take.name for take in (matches or self.takes)[:8]) or "none"
        reason = "several takes begin with this name" if matches else "there is no such take"
        raise TakeError(f"{name}: {reason}; there are: {names}")


def scan(directory: Path) -> Listing:
    """List the takes of a directory from every file that has a take's name.

    Raises:
        TakeError: the directory cannot be read.
    """
    try:
        files = sorted(file for file in directory.iterdir() if file.name.removesuffix(PARTIAL).endswith(".mcap"))
    except OSError as error:
        raise TakeError(f"{directory}: {error.strerror or error}") from error
    cached = _read_cache(directory)
    entries = [entry for file in files if (entry := _entry(file, cached)) is not None]
    _write_cache(directory, entries, cached)
    return _listing(directory, entries)


def _entry(file: Path, cache: dict[str, FileEntry]) -> FileEntry | None:
    try:
        stat = file.stat()
    except OSError:  # the file was renamed or removed meanwhile
        return None
    cached = cache.get(file.name)
    if cached is not None and (cached.size, cached.mtime_ns) == (stat.st_size, stat.st_mtime_ns):
        return cached
    try:
        part = PartReader(file)
    except TakeError as error:
        return FileEntry(file.name, stat.st_size, stat.st_mtime_ns, str(error).removeprefix(f"{file}: "))
    try:
        return _described(part, file.name, stat.st_mtime_ns)
    finally:
        part.close()


def _described(part: PartReader, name: str, mtime_ns: int) -> FileEntry:
    index, counts = part.index, part.counts()
    return FileEntry(
        name,
        index.size,
        mtime_ns,
        "; ".join(part.problems),
        part.metadata.get("session", ""),
        part.metadata.get("device", ""),
        part.metadata.get("continues", ""),
        counts["left"],
        counts["right"],
        index.first_ns,
        index.last_ns,
    )


def _listing(directory: Path, entries: list[FileEntry]) -> Listing:
    out = Listing()
    groups: dict[tuple[str, str], list[FileEntry]] = {}
    for entry in entries:
        if entry.problem and not entry.first_ns and not entry.session:
            out.other_files[entry.name] = entry.problem
        else:
            groups.setdefault((_parsed(entry)[0], entry.session), []).append(entry)
    for members in groups.values():
        out.takes.append(_take(directory, sorted(members, key=_parsed)))
    out.takes.sort(key=lambda take: (take.start_ns, take.name))
    return out


def _parsed(entry: FileEntry) -> tuple[str, int]:
    """Return the name of the take and the number of the part."""
    match = _PART.fullmatch(entry.name.removesuffix(PARTIAL))
    return (match["take"], int(match["number"] or 1)) if match else (entry.name, 1)


def _take(directory: Path, members: list[FileEntry]) -> TakeEntry:
    first = members[0]
    take = TakeEntry(_parsed(first)[0], session=first.session, device=first.device)
    for entry in members:
        take.files.append(entry.name)
        take.bytes += entry.size
        take.frames = [take.frames[0] + entry.left, take.frames[1] + entry.right]
        take.interruptions += bool(entry.continues)
        writing = entry.name.endswith(PARTIAL) and being_written(directory / entry.name)
        if entry.problem and not writing:
            take.problems.append(f"{entry.name}: {entry.problem}")
        take.state = _worse(take.state, entry, writing)
    times = [t for entry in members for t in (entry.first_ns, entry.last_ns) if t]
    take.start_ns, take.end_ns = min(times, default=0), max(times, default=0)
    return take


def _worse(state: str, entry: FileEntry, writing: bool) -> str:
    if writing:
        return "writing"
    if state == "writing" or not entry.problem:
        return state
    return "unfinished" if entry.name.endswith(PARTIAL) and state != "damaged" else "damaged"


def _read_cache(directory: Path) -> dict[str, FileEntry]:
    with suppress(OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError):
        path = directory / CACHE
        if path.stat().st_size <= _MAX_CACHE_BYTES:
            data = json.loads(path.read_bytes())
            if data["version"] == _VERSION:
                return {entry.name: entry for entry in _checked(data["files"])}
    return {}


def _checked(rows: list[dict[str, Any]]) -> Iterator[FileEntry]:
    """Yield the entries of the right shape only: any program may have changed the file."""
    kinds = {name: type(value) for name, value in asdict(FileEntry("", 0, 0)).items()}
    for row in rows:
        if {name: type(value) for name, value in row.items()} == kinds:
            yield FileEntry(**row)


def _write_cache(directory: Path, entries: list[FileEntry], cached: dict[str, FileEntry]) -> None:
    finished = {entry.name: entry for entry in entries if not entry.name.endswith(PARTIAL)}
    if finished == cached:
        return
    rows = [asdict(entry) for entry in finished.values()]
    with suppress(OSError):  # a directory that cannot be written is read again each time
        write_atomically(directory / CACHE, json.dumps({"version": _VERSION, "files": rows}).encode())
