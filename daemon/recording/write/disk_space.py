"""The disk that a take is written to: how much room there is, and whether it is still the same one."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

_CLOSING_BYTES = 1 << 20
"""Index and footer of a part must still fit when the guard ends it."""
_MARGIN_BYTES = 64 << 20
"""So much more than the limit must be free before a take goes on: else it would stop again at once."""


class Disk:
    """A directory, and the free space that must stay there.

    Args:
        directory: of the takes, existing; min_free_bytes: what must stay free; free_bytes: free space of a directory.
    """

    def __init__(self, directory: Path, min_free_bytes: int, free_bytes: Callable[[Path], int]) -> None:
        self.directory, self._min_free_bytes, self._free_bytes = directory, min_free_bytes, free_bytes
        self._number = directory.stat().st_dev

    def problem(self, size: int = 0) -> str | None:
        """Why so many bytes must not be written; None if they may."""
        return self._told(size, "make room or lower recording.min_free_mb")

    def is_another(self, known: Iterable[Path]) -> str | None:
        """What to say if another disk is there now, without any of these files; OSError if none is there."""
        if self.directory.stat().st_dev == self._number or any(path.exists() for path in known):
            return None
        return f"{self.directory}: another disk is mounted there, without the files of this take"

    def problem_to_go_on(self, size: int) -> str | None:
        """Why an interrupted take, of which so many bytes wait, cannot go on yet."""
        wanted = max(self._min_free_bytes, _CLOSING_BYTES)
        margin = min(_MARGIN_BYTES, wanted // 10)
        return self._told(size + margin, f"it goes on at {(wanted + size + margin) / 1e6:.0f} MB")

    def _told(self, size: int, advice: str) -> str | None:
        free = self._free_bytes(self.directory)
        if free - size >= max(self._min_free_bytes, _CLOSING_BYTES):
            return None
        return (
            f"{self.directory}: {free / 1e6:.0f} MB free, recording leaves {self._min_free_bytes / 1e6:.0f} MB and"
            f" writes no more; {advice}"
        )
