"""A disk with faults set by a test: full, broken, read-only, gone, or hanging, below the recorder's own calls."""

from __future__ import annotations

import errno
import os
import threading
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

_ERRORS = {"full": errno.ENOSPC, "io": errno.EIO, "readonly": errno.EROFS, "gone": errno.ENODEV}
_CALLS = ("open", "writev", "fdatasync", "fsync", "ftruncate", "lseek", "unlink")
_QUIET = {"full": {"fdatasync", "fsync", "ftruncate", "lseek", "unlink"}, "readonly": {"lseek"}}


class Disk:
    """Stands where the recorder's modules have ``os``; calls without a fault pass through.

    Args:
        mode: ``ok``, ``full`` (a part of what is written still fits), ``io``, ``readonly``, ``gone`` or ``hang``.
    """

    def __init__(self) -> None:
        self.mode = "ok"
        self.asked: Counter[str] = Counter()
        self.synced: dict[int, int] = {}  # inode -> size that is safe
        self._go = threading.Event()

    def __getattr__(self, name: str) -> Any:
        real = getattr(os, name)
        return self._through(name, real) if name in _CALLS else real

    def heal(self) -> None:
        """The disk is well again; who hangs goes on."""
        self.mode = "ok"
        self._go.set()

    def hang(self) -> None:
        """Let every call hang from now on."""
        self._go.clear()
        self.mode = "hang"

    def _through(self, name: str, real: Callable[..., Any]) -> Callable[..., Any]:
        def call(*args: Any, **options: Any) -> Any:
            mode = self.mode
            self.asked[f"{mode} {name}"] += 1
            if mode == "hang":
                assert self._go.wait(60)
            elif mode != "ok" and name not in _QUIET.get(mode, ()):
                if mode == "full" and name == "writev":
                    os.write(args[0], bytes(args[1][0])[:100])  # what the full disk still takes
                raise OSError(_ERRORS[mode], os.strerror(_ERRORS[mode]))
            result = real(*args, **options)
            if name in ("fdatasync", "fsync"):
                self._note(args[0])
            return result

        return call

    def _note(self, handle: int) -> None:
        stat = os.fstat(handle)
        self.synced[stat.st_ino] = stat.st_size

    def power_cut(self, directory: Path, rng: Any) -> None:
        """What was not synced is lost, from any byte on."""
        for file in directory.iterdir():
            stat = file.stat()
            safe = self.synced.get(stat.st_ino, 0)
            if stat.st_size > safe:
                os.truncate(file, int(rng.integers(safe, stat.st_size + 1)))


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    made = Disk()
    for module in ("part_writer", "disk_sync", "part_chain"):
        monkeypatch.setattr(f"daemon.recording.write.{module}.os", made)
    return made
