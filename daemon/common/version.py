"""The installed version."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version


def program_version() -> str:
    """The installed version of the project."""
    try:
        return version("fringed")
    except PackageNotFoundError:
        return "unknown"
