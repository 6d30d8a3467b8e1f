"""The names of a take's files: ``take.mcap``, then ``take_part002.mcap`` and so on; ``.partial`` while being written."""

from __future__ import annotations

from pathlib import Path

PARTIAL = ".partial"
_MAX_PARTS = 10_000


def part_path(path: Path, number: int) -> Path:
    """The file of a part; the first part has the name of the take."""
    return path if number == 1 else path.with_name(f"{path.stem}_part{number:03d}{path.suffix}")


def of_take(path: Path) -> list[Path]:
    """The existing files of a take in order, given its first; the last may be unfinished.

    Any other file is a take of its own.
    """
    first = path.with_name(path.name.removesuffix(PARTIAL))
    found = [path]
    for number in range(2, _MAX_PARTS):
        part = part_path(first, number)
        unfinished = part.with_name(part.name + PARTIAL)
        if part.is_file():
            found.append(part)
        elif unfinished.is_file():
            found.append(unfinished)
        else:
            break
    return found
