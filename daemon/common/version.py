"""The installed version."""

from __future__ import annotations

import fringed


def program_version() -> str:
    """The installed version of the project."""
    version: str = fringed.__version__
    return version
