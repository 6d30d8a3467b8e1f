"""``fringed.open``: a recording, or a running daemon, by its place."""

from __future__ import annotations

from importlib.metadata import entry_points
from os import PathLike, fspath
from pathlib import Path
from typing import Any

from fringed.errors import ArgumentError, RecordingError
from fringed.files.cloud_store import NAME as STORE
from fringed.rig.folder import SUFFIX, NpzClouds, ZarrClouds
from fringed.rig.live import Rig
from fringed.rig.recorded import Reader, Recording
from fringed.rig.source import Source

READERS = "fringed.readers"
"""Group of entry points: readers of recordings that this package cannot read itself, by the file's suffix."""

_TAKE = ".mcap"
_PARTIAL = ".partial"


def open_source(place: str | PathLike[str], *, repeat: bool = False, **options: Any) -> Source:
    """Open a recording with the interface of a running daemon.

        with fringed.open("take.mcap") as rig:
            for cloud in rig.clouds():
                print(cloud.header.seq, cloud.points.shape)

    Args:
        place: a take (``take.mcap``, ``s3://bucket/take.mcap``), which is reconstructed; a folder of clouds
            (``fringed replay TAKE --out FOLDER``), a snapshot (``*.npz``) or a Zarr store (``fringed reprocess``); or
            the address of a daemon, ``tcp://HOST:PORT`` or ``ipc://PATH``.
        repeat: begin a recording again at its end, for programs without an end.
        options: of :class:`fringed.Rig`, for the address of a daemon.

    Raises:
        RecordingError: no recording there, or one that this installation cannot read.
        ArgumentError, NoDaemonError: as of :class:`fringed.Rig`.
    """
    text: object = fspath(place) if isinstance(place, str | PathLike) else None
    if not isinstance(text, str) or not text:
        raise ArgumentError(f"place is {place!r:.60}, expected a path, a URL, or the address of a daemon")
    if text.startswith(("tcp://", "ipc://")):
        return Rig(text, **options)
    if options:
        raise ArgumentError(f"{next(iter(options))} is an option for the address of a daemon; {text!r:.100} is none")
    return Recording(_reader(text), repeat=repeat)


def _reader(text: str) -> Reader:
    if text.removesuffix(_PARTIAL).endswith(_TAKE):
        return _take_reader(text)
    if "://" in text:
        return ZarrClouds(text)
    path = Path(text)
    if path.is_file() and path.suffix == SUFFIX:
        return NpzClouds(path)
    if not path.is_dir():
        raise RecordingError(
            f"{text}: {'no recording that can be opened' if path.exists() else 'there is no such file'}"
        )
    if path.suffix == ".zarr" or (path / STORE).exists():
        return ZarrClouds(text)
    if any(path.glob(f"*{SUFFIX}")):
        return NpzClouds(path)
    takes = sorted(file.name for file in path.glob(f"*{_TAKE}*"))
    hint = (
        f"name one of its takes: {', '.join(takes[:5])}" if takes else "`fringed replay TAKE --out FOLDER` writes some"
    )
    raise RecordingError(f"{text}: there are no clouds (*{SUFFIX}) in it; {hint}")


def _take_reader(text: str) -> Reader:
    """Open a take with the reconstruction, which another distribution provides."""
    if "://" not in text and not Path(text).is_file():
        raise RecordingError(f"{text}: there is no such file")
    found = entry_points(group=READERS, name=_TAKE.removeprefix("."))
    try:
        for entry in found:
            reader: Reader = entry.load()(text)
            return reader
    except ModuleNotFoundError as error:
        raise _not_installed(text, f"the package {error.name} is missing") from error
    raise _not_installed(text, "only the client is installed")


def _not_installed(text: str, why: str) -> RecordingError:
    return RecordingError(
        f"{text}: a take holds camera images, and reconstructing them needs the packages of a rig PC ({why}): "
        "pip install fringed-rig. Clouds of `fringed replay TAKE --out FOLDER` open without them"
    )
