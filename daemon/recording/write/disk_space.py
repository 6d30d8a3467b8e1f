"""The disk that a take is written to: its free space, and whether another one was mounted in its place."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

_CLOSING_BYTES = 1 << 20
"""Room for index and footer of a part that is ended for lack of space."""
_MARGIN_BYTES = 64 << 20
"""Free space beyond the limit that an interrupted take needs before it resumes; else it would stop at once."""


class DiskGuard:
    """A directory, and the free space that must stay there.

    Args:
        directory: of the takes, existing; min_free_bytes: to stay free; free_bytes: returns the free space.
    """

    def __init__(self, directory: Path, min_free_bytes: int, free_bytes: Callable[[Path], int]) -> None:
        self.directory, self._min_free_bytes, self._free_bytes = directory, min_free_bytes, free_bytes
        self._device = directory.stat().st_dev

    def problem(self, size: int = 0) -> str | None:
        """Return why ``size`` more bytes must not be written; None if they may."""
        return self._problem(size, "make room or lower recording.min_free_mb")

    def problem_if_replaced(self, known: Iterable[Path]) -> str | None:
        """Return the problem where another disk without any of these files is mounted; OSError where none is."""
        if self.directory.stat().st_dev == self._device or any(path.exists() for path in known):
            return None
        return f"{self.directory}: another disk is mounted there, without the files of this take"

    def problem_to_resume(self, size: int) -> str | None:
        """Return why an interrupted take, of which ``size`` bytes wait, cannot resume yet."""
        least = max(self._min_free_bytes, _CLOSING_BYTES)
        margin = min(_MARGIN_BYTES, least // 10)
        return self._problem(size + margin, f"it resumes at {(least + size + margin) / 1e6:.0f} MB")

    def _problem(self, size: int, advice: str) -> str | None:
        free = self._free_bytes(self.directory)
        if free - size >= max(self._min_free_bytes, _CLOSING_BYTES):
            return None
        return (
            f"{self.directory}: {free / 1e6:.0f} MB free, recording leaves {self._min_free_bytes / 1e6:.0f} MB and"
            f" writes no more; {advice}"
        )
