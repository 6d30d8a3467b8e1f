"""Projectors: one at an output of the graphics card, and one that other programs drive.

Nothing here imports pyglet or connects to X in this process: window and listing run in processes of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.projector.driver import OutputProjector
from drivers.projector.external import ExternalProjector
from drivers.projector.options import ExternalOptions, ProjectorOptions, read
from drivers.projector.x11.detected_output import DetectedOutput
from drivers.projector.x11.listing import outputs

__all__ = ["DetectedOutput", "ExternalProjector", "OutputProjector", "open_external", "open_projector", "outputs"]


def open_projector(options: Mapping[str, Any], base_dir: Path) -> OutputProjector:
    """Create a closed projector at a RandR output.

    Args:
        options: as in :class:`drivers.projector.options.ProjectorOptions`; base_dir: directory of its hooks.

    Raises:
        ValueError: "projector.KEY: ..." names the invalid option.
    """
    return OutputProjector(read(ProjectorOptions, options), base_dir)


def open_external(options: Mapping[str, Any], base_dir: Path) -> ExternalProjector:
    """Create a closed projector that other programs drive.

    Args:
        options: as in :class:`drivers.projector.options.ExternalOptions`; base_dir: directory of its hooks.

    Raises:
        ValueError: "projector.KEY: ..." names the invalid option.
    """
    return ExternalProjector(read(ExternalOptions, options), base_dir)
