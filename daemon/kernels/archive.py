"""Archives of compiled kernels: those of one level of x86-64 and one version of Python, with what they were made from.

``cp311-x86-64-v3.json`` is the description of ``cp311-x86-64-v3.tar.xz``. The archive has the index and data files of
numba's cache by the folders of their sources, and the mark of :mod:`daemon.kernels.cache`.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import secrets
import shutil
import tarfile
from dataclasses import asdict, dataclass
from pathlib import Path, PurePosixPath

from daemon.common.errors import DaemonError
from daemon.common.files import source_files, write_atomically
from daemon.kernels import cache


class ArchiveError(DaemonError):
    """An archive of kernels that cannot be used, with the reason."""


@dataclass(frozen=True, slots=True)
class Description:
    """What an archive was made from.

    Args:
        level: of x86-64; libraries: see :func:`daemon.kernels.cache.libraries`.
        sources, key: as in :mod:`daemon.kernels.cache`; sha256: of the archive.
    """

    level: str
    libraries: dict[str, str]
    sources: str
    key: str
    sha256: str

    def mismatch(self) -> str:
        """Why the kernels do not suit this installation; empty if they do."""
        here = cache.libraries()
        for name, made in self.libraries.items():
            if here.get(name) != made:
                return f"they were compiled with {name} {made}, here is {here.get(name)}"
        if self.sources != cache.sources_key():
            return "they were compiled from other sources"
        return "" if self.key == cache.cache_key() else f"they were compiled for {self.level}"


def description_file(folder: Path, level: str, python: str) -> Path:
    """Path of a description."""
    return folder / f"cp{python.replace('.', '')}-{level}.json"


def read_description(path: Path) -> Description:
    """Read a description; ArchiveError for a damaged one."""
    try:
        return Description(**json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError) as error:
        raise ArchiveError(f"{path} cannot be read: {error}") from error


def pack(cached: Path, folder: Path, level: str) -> Path:
    """Write the archive of a cache (``NUMBA_CACHE_DIR``), then its description; returns the latter's path."""
    import lzma

    plain = io.BytesIO()
    with tarfile.open(fileobj=plain, mode="w") as tar:
        for name, sub in _folders().items():
            for path in sorted((cached / sub).glob("*.nb[ic]")):
                _add(tar, f"{name}/{path.name}", path.read_bytes())
        _add(tar, cache.MARK, (cached / cache.MARK).read_bytes())
    data = lzma.compress(plain.getvalue(), preset=9 | lzma.PRESET_EXTREME)
    libraries, digest = cache.libraries(), hashlib.sha256(data).hexdigest()
    target = description_file(folder, level, libraries["python"])
    folder.mkdir(parents=True, exist_ok=True)
    write_atomically(target.with_suffix(".tar.xz"), data)
    made = Description(level, libraries, cache.sources_key(), cache.cache_key(), digest)
    write_atomically(target, json.dumps(asdict(made), indent=1).encode())
    return target


def unpack(description: Path, folder: Path) -> int:
    """Make ``folder`` from an archive, as a whole or not at all; returns the number of files.

    A folder with a mark, which another process made meanwhile, is kept. One without is replaced: numba makes empty
    folders as soon as a module with kernels is imported.

    Raises:
        ArchiveError: the archive is damaged or made for another installation; OSError: the folder cannot be written.
    """
    made = read_description(description)
    reason = made.mismatch()
    if reason:
        raise ArchiveError(reason)
    files = _contents(description.with_suffix(".tar.xz"), made.sha256)
    fresh, old = (folder.with_name(f".{folder.name}.{secrets.token_hex(4)}.tmp") for _ in range(2))
    try:
        for name, data in files.items():
            path = fresh / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(data)
        if folder.is_dir() and not (folder / cache.MARK).exists():
            folder.rename(old)
        try:
            fresh.rename(folder)
        except OSError:
            if not folder.is_dir():
                raise
    finally:
        for path in (fresh, old):
            shutil.rmtree(path, ignore_errors=True)
    return len(files)


def _contents(path: Path, sha256: str) -> dict[str, bytes]:
    """The files of an archive by their paths in a cache of this installation."""
    try:
        import lzma

        data = path.read_bytes()
        if hashlib.sha256(data).hexdigest() != sha256:
            raise ArchiveError(f"{path} is damaged: its SHA-256 is not that of its description")
        folders, files = _folders(), {}
        with tarfile.open(fileobj=io.BytesIO(lzma.decompress(data))) as tar:
            for member in tar:
                content, name = tar.extractfile(member), PurePosixPath(member.name)
                if content is not None and name.name == member.name == cache.MARK:
                    files[member.name] = content.read()
                elif content is not None and str(name.parent) in folders:
                    files[os.path.join(folders[str(name.parent)], name.name)] = content.read()  # noqa: PTH118
                else:
                    raise ArchiveError(f"{path}: {member.name!r:.80} is no compiled kernel of this project")
    except (ImportError, tarfile.TarError, ValueError, EOFError) as error:
        raise ArchiveError(f"{path} cannot be read: {error}") from error
    return files


def _folders() -> dict[str, str]:
    """Folders of sources, relative to the project, with their folders in a cache of numba."""
    from numba.core.caching import UserProvidedCacheLocator

    sources = {path.parent for package in cache.PACKAGES for path in source_files(cache.ROOT / package)}
    return {
        folder.relative_to(cache.ROOT).as_posix(): UserProvidedCacheLocator.get_suitable_cache_subpath(
            str(folder / "any.py")
        )
        for folder in sorted(sources)
    }


def _add(tar: tarfile.TarFile, name: str, data: bytes) -> None:
    member = tarfile.TarInfo(name)
    member.size = len(data)
    tar.addfile(member, io.BytesIO(data))
