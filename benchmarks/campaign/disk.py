"""A small disk of the campaign, which can be filled, made read-only and removed."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path


class Disk:
    """A file system in memory at a directory; needs root.

    Args:
        at: mount point; size_mb: of the disk.
    """

    def __init__(self, at: Path, size_mb: int) -> None:
        self.at, self._size_mb = at, size_mb
        self._filler = at / "filler"
        at.mkdir()
        self._mount()

    @property
    def takes(self) -> Path:
        """Where takes are written."""
        return self.at / "takes"

    def fill(self) -> None:
        """Fill the disk."""
        with self._filler.open("wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(1 << 20))
            except OSError:
                pass

    def refuse(self) -> None:
        """Mount it again for reading only; that fails while a file is open for writing: then the directory goes."""
        if self._run("mount", "-o", "remount,ro", str(self.at)):
            self.takes.rename(self.at / "away")

    def pull(self) -> None:
        """Take it away with whatever is open on it; another, empty disk is there afterwards."""
        self._run("umount", "--lazy", str(self.at))

    def mend(self) -> None:
        """Make the disk writable again, with free space."""
        if not os.path.ismount(self.at):
            self._mount()
        self._run("mount", "-o", "remount,rw", str(self.at))
        self._filler.unlink(missing_ok=True)
        away = self.at / "away"
        if away.exists():
            if self.takes.exists():
                for file in away.iterdir():
                    file.rename(self.takes / file.name)
                away.rmdir()
            else:
                away.rename(self.takes)

    def close(self) -> None:
        """Unmount for good."""
        while os.path.ismount(self.at):
            if self._run("umount", "--lazy", str(self.at)):
                return

    def _mount(self) -> None:
        command = ["mount", "-t", "tmpfs", "-o", f"size={self._size_mb}m,mode=0755", "campaign", str(self.at)]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            raise SystemExit(
                f"a disk of its own cannot be mounted at {self.at}, the campaign needs root: {done.stderr}"
            )

    @staticmethod
    def _run(*command: str) -> int:
        return subprocess.run(command, capture_output=True, check=False).returncode
