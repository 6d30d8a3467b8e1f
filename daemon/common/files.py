"""Files: written whole or not at all, read with a limit to their size, closed to other users."""

from __future__ import annotations

import contextlib
import ctypes
import errno
import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from daemon.common.errors import InputError

_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
_AT_FDCWD, _RENAME_NOREPLACE = -100, 1


def source_files(folder: Path) -> Iterator[Path]:
    """Files below a folder, in order, without the caches beside sources, which starting programs fill meanwhile."""
    for parent, folders, names in os.walk(folder):
        folders[:] = sorted(set(folders) - {"__pycache__"})
        yield from (Path(parent) / name for name in sorted(names))


def checked_name(name: str) -> str:
    """Return a name that is safe as the beginning of a file's name: no separators, no leading dot.

    Raises:
        InputError: any other name.
    """
    if not _NAME.fullmatch(name):
        raise InputError(f"the name {name!r:.80} takes letters, digits, '.', '_' and '-', at most 64, not '.' first")
    return name


def write_atomically(path: Path, data: bytes) -> None:
    """Write ``data`` as the file ``path``; after a crash the file holds either the old bytes or the new ones.

    Raises:
        OSError: the directory cannot be written; the old file is untouched.
    """
    path = Path(path)
    handle, name = tempfile.mkstemp(prefix=f".{path.name}.", suffix=".tmp", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), _mode(path))
            os.fsync(file.fileno())
        Path(name).replace(path)
    except BaseException:
        with contextlib.suppress(OSError):
            Path(name).unlink()
        raise
    sync_directory(path.parent)


def rename_without_replacing(path: Path, target: Path) -> None:
    """Rename a file atomically within its file system if nothing has the new name; directories are not synchronised.

    File systems that cannot rename so (NFS) get a hard link first; those without hard links, too, are not atomic.

    Raises:
        FileExistsError: something has the name; both are untouched. OSError: the directory cannot be written.
    """
    number = _renameat2(path, target)
    if number == 0:
        return
    if number not in (errno.EINVAL, errno.ENOSYS):
        raise OSError(number, os.strerror(number), str(path), None, str(target))
    try:
        os.link(path, target)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        if target.exists():
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path), None, str(target)) from None
        path.rename(target)
    else:
        path.unlink()


def _renameat2(path: Path, target: Path) -> int:
    """Rename if the new name is free; return 0 or the number of the error, ENOSYS without the function."""
    function = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if function is None:
        return errno.ENOSYS
    failed = function(_AT_FDCWD, os.fsencode(path), _AT_FDCWD, os.fsencode(target), _RENAME_NOREPLACE)
    return ctypes.get_errno() if failed else 0


def sync_directory(directory: Path) -> None:
    """Make new or changed names in a directory survive a power cut."""
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def read_at_most(path: Path, limit: int, error: type[Exception]) -> bytes:
    """Read a file of at most ``limit`` bytes; anything else raises ``error``, which names the file."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(limit + 1)
    except OSError as problem:
        raise error(f"{path}: {problem.strerror or problem}") from problem
    if len(data) > limit:
        raise error(f"{path}: larger than {limit} bytes; this is not the file that is expected here")
    return data


def existing_parent(path: Path) -> Path:
    """Return the path itself, or the nearest directory above it that exists."""
    path = path.absolute()
    while not path.exists() and path != path.parent:
        path = path.parent
    return path


def restrict_umask() -> None:
    """Create files from now on for the user, readable by the group, closed to everyone else."""
    os.umask(os.umask(0o027) | 0o027)


def _mode(path: Path) -> int:
    """Permissions of the file that is replaced, or those that the umask gives a new one."""
    try:
        return path.stat().st_mode & 0o7777
    except FileNotFoundError:
        mask = os.umask(0o077)
        os.umask(mask)
        return 0o666 & ~mask
