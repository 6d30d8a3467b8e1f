"""The names of a take's files: ``take.mcap``, then ``take_part002.mcap`` and so on; ``.partial`` while written."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from daemon.recording.format.errors import TakeError

CALIBRATION, PATTERN, VOLUME, RIG = "calibration.yaml", "pattern.json", "volume.json", "rig.yaml"
PARTIAL = ".partial"


def part_path(path: Path, number: int) -> Path:
    """Return the file of a part; the first part has the name of the take."""
    return path if number == 1 else path.with_name(f"{path.stem}_part{number:03d}{path.suffix}")


def files_of_take(path: Path) -> list[Path]:
    """Return the existing files of a take in order, given its first or their directory; any may be unfinished.

    Any other file is a take of its own.
    """
    if path.is_dir():
        return _of_directory(path)
    first = path.with_name(path.name.removesuffix(PARTIAL))
    unfinished, later = first.with_name(first.name + PARTIAL), _later_parts(first)
    if path.exists():
        return [path, *later]
    return [unfinished, *later] if unfinished.exists() else later or [path]


def _later_parts(first: Path) -> list[Path]:
    """Return the parts after the first, by number; an endless recording may have removed some."""
    parts: dict[int, Path] = {}
    with suppress(OSError):
        for file in sorted(first.parent.iterdir()):
            match = _numbered(first, file.name)
            if match is not None:
                parts.setdefault(match, file)  # sorted: the finished one before the unfinished
    return [parts[number] for number in sorted(parts)]


def _numbered(first: Path, name: str) -> int | None:
    """Return the number in the name of a later part of this take; None for other files."""
    middle = name.removesuffix(PARTIAL).removesuffix(first.suffix)
    digits = middle.removeprefix(f"{first.stem}_part")
    if middle == name or digits == middle or not (digits.isascii() and digits.isdigit() and 3 <= len(digits) <= 6):
        return None
    return int(digits)


def _of_directory(directory: Path) -> list[Path]:
    files = sorted(file for file in directory.iterdir() if file.name.endswith((".mcap", f".mcap{PARTIAL}")))
    if not files:
        raise TakeError(f"{directory}: no .mcap file in this directory")
    return files
