"""Directories that may not be there yet."""

from __future__ import annotations

from pathlib import Path


def existing(path: Path) -> Path:
    """The path itself, or the nearest directory above it that is there."""
    path = path.absolute()
    while not path.exists() and path != path.parent:
        path = path.parent
    return path
