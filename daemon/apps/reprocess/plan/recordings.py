"""The recordings that sources name: folders, glob patterns, files, each as path or URL."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from daemon.apps.reprocess.locations import is_local, location
from daemon.common.errors import DaemonError

_FILE = re.compile(r"(?P<take>.+?)(?:_part(?P<number>\d{3,6}))?\.mcap(?P<partial>\.partial)?")
_WILD = re.compile(r"[*?\[]")


@dataclass(frozen=True, slots=True)
class Recording:
    """A take to be reconstructed.

    Args:
        name: of its folder in the destination, unique among all recordings of a run.
        url: path or URL of its first file.
    """

    name: str
    url: str


def recordings_of(sources: Iterable[str]) -> list[Recording]:
    """Every take of the sources once, in the order of their names.

    Raises:
        DaemonError: a source without recordings, or two recordings that would share one name.
    """
    found: dict[str, Recording] = {}
    for source in sources:
        here = _of_source(source)
        if not here:
            raise DaemonError(
                f"{source}: no .mcap file there; give a folder, a file, or a pattern such as 'takes/*.mcap'"
            )
        for recording in here:
            other = found.setdefault(recording.name, recording)
            if other.url != recording.url:
                raise DaemonError(
                    f"{other.url} and {recording.url} would both write into the folder {recording.name}; reprocess "
                    "them into two destinations, or name the folder above both"
                )
    return [found[name] for name in sorted(found)]


def _of_source(source: str) -> list[Recording]:
    wild = _WILD.search(source)
    if wild is not None:
        root = source[: wild.start()].rpartition("/")[0] + ("/" if "/" in source[: wild.start()] else "")
        base = location(root or ".")
        return _takes(base, base.glob(source[len(root) :]))
    base = location(source)
    if base.is_dir():
        return _takes(base, base.glob("**/*.mcap*"))
    return [Recording(_name(base.name), str(base))] if base.exists() else []


def _takes(base: Path, files: Iterable[Path]) -> list[Recording]:
    """Group the parts of each take; its first existing part stands for it."""
    first: dict[str, tuple[int, str, Path]] = {}
    for file in files:
        match = _FILE.fullmatch(file.name)
        if match is None:
            continue
        relative = PurePosixPath(_inside(base, file)).with_name(match["take"])
        rank = int(match["number"] or 1), match["partial"] or "", file
        if str(relative) not in first or rank[:2] < first[str(relative)][:2]:
            first[str(relative)] = rank
    return [Recording(name, str(file)) for name, (_, _, file) in first.items()]


def _inside(base: Path, file: Path) -> str:
    if is_local(base):
        return file.relative_to(base).as_posix()
    return str(file.path).removeprefix(str(base.path).rstrip("/")).lstrip("/")  # type: ignore[attr-defined]


def _name(file: str) -> str:
    match = _FILE.fullmatch(file)
    return file if match is None else match["take"]
