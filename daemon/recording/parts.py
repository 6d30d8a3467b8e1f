"""The names of a take's files: ``take.mcap``, then ``take_part002.mcap`` and so on; ``.partial`` while written."""

from __future__ import annotations

from pathlib import Path

from daemon.recording.errors import TakeError

CALIBRATION, PATTERN, VOLUME, RIG = "calibration.yaml", "pattern.json", "volume.json", "rig.yaml"
PARTIAL = ".partial"
_MAX_PARTS = 10_000


def part_path(path: Path, number: int) -> Path:
    """The file of a part; the first part has the name of the take."""
    return path if number == 1 else path.with_name(f"{path.stem}_part{number:03d}{path.suffix}")


def of_take(path: Path) -> list[Path]:
    """The existing files of a take in order, given its first or their directory; the last may be unfinished.

    Any other file is a take of its own.
    """
    if path.is_dir():
        return _of_directory(path)
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


def _of_directory(directory: Path) -> list[Path]:
    files = sorted(file for file in directory.iterdir() if file.name.endswith((".mcap", f".mcap{PARTIAL}")))
    if not files:
        raise TakeError(f"{directory}: no .mcap file in this directory")
    return files
