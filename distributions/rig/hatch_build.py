"""Names the files of the wheel: packages and other files of the repository's top level, and compiled kernels."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

PACKAGES = "daemon", "drivers", "pipeline", "sim"
SHARE = "systemd", "schema", "constraints.txt", "LICENSE"
"""What `fringed install` puts into place, and the JSON schema of rig.yaml."""
KERNELS = "FRINGED_KERNELS"
"""Environment variable: a folder of archives, written by `python -m tools.release`."""


class Files(BuildHookInterface):
    """Adds the files; an editable installation only points to the repository."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Called by hatchling before the wheel is built."""
        top = Path(self.root).parents[1]
        if version == "editable":
            return
        include, shared = build_data["force_include"], build_data["shared_data"]
        for package in PACKAGES:
            include |= {str(path): str(path.relative_to(top)) for path in _files(top / package)}
        for name in SHARE:
            shared |= {str(path): f"share/fringed/{path.relative_to(top)}" for path in _files(top / name)}
        for path in sorted(Path(os.environ[KERNELS]).iterdir()) if KERNELS in os.environ else ():
            include[str(path)] = f"daemon/kernels/compiled/{path.name}"


def _files(place: Path) -> list[Path]:
    """A file, or all files of a folder."""
    paths = sorted(place.rglob("*")) if place.is_dir() else [place]
    return [path for path in paths if path.is_file() and "__pycache__" not in path.parts]
