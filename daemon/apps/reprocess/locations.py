"""Paths and URLs: every place that a run reads from or writes to, behind the interface of ``pathlib.Path``."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

from daemon.common.errors import DaemonError
from daemon.common.files import write_atomically

_LOCAL = ("file", "local")
_OBJECT_STORES = ("s3", "s3a", "gs", "gcs", "az", "abfs", "memory")
"""A name appears there only with its whole content."""


def location(text: str) -> Path:
    """The place of a path or URL; for a URL an object that has the methods of ``Path``.

    Raises:
        DaemonError: the package for this kind of URL is not installed.
    """
    protocol, separator, _ = text.partition("://")
    if not separator:
        return Path(text)
    if protocol in _LOCAL:
        return Path(unquote(urlsplit(text).path))
    place: Path = _remote(text, protocol)
    return place


def remote(*texts: str) -> bool:
    """Whether one of these places is reached over a network library."""
    return any("://" in text for text in texts)


def is_local(place: Path) -> bool:
    """Whether it is a path of a mounted file system."""
    return isinstance(place, Path)


def write_whole(place: Path, data: bytes) -> None:
    """Write a file whole or not at all; its folder is made when it is missing.

    Raises:
        OSError: it cannot be written; an older file is untouched.
    """
    if is_local(place):
        place.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(place, data)
        return
    remote: Any = place
    if remote.protocol in _OBJECT_STORES:
        remote.write_bytes(data)
        return
    remote.parent.mkdir(parents=True, exist_ok=True)
    partial = remote.with_name(f".{remote.name}.{os.getpid()}.tmp")
    partial.write_bytes(data)
    remote.fs.mv(partial.path, remote.path)


def read_if_there(place: Path) -> bytes | None:
    """The content of a file, None if there is none."""
    try:
        return place.read_bytes()
    except (FileNotFoundError, NotADirectoryError):
        return None


def _remote(text: str, protocol: str) -> Any:
    try:
        from upath import UPath
    except ModuleNotFoundError as error:
        raise DaemonError(
            f"{text}: URLs need the packages of the extra cluster: pip install 'fringed-rig[cluster]'"
        ) from error
    try:
        place: Any = UPath(text)
        _ = place.fs
    except (ImportError, ValueError) as error:
        raise DaemonError(f"{text}: {protocol}:// cannot be used: {error}; for s3:// install s3fs") from error
    return place
