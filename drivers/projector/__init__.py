"""Projectors: one at an output of the graphics card, and one that other programs drive.

Nothing here imports pyglet or touches X in this process: the window and the listing live in processes of their own.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.projector.detected_output import DetectedOutput
from drivers.projector.driver import OutputProjector
from drivers.projector.external import ExternalProjector
from drivers.projector.listing import outputs
from drivers.projector.options import ExternalOptions, ProjectorOptions, read

__all__ = ["DetectedOutput", "ExternalProjector", "OutputProjector", "open_external", "open_projector", "outputs"]


def open_projector(options: Mapping[str, Any], base_dir: Path) -> OutputProjector:
    """A projector at a RandR output, closed.

    Args:
        options: as in :class:`drivers.projector.options.ProjectorOptions`; base_dir: where its hooks run.

    Raises:
        ValueError: "projector.KEY: ..." says what is wrong with which option.
    """
    return OutputProjector(read(ProjectorOptions, options), base_dir)


def open_external(options: Mapping[str, Any], base_dir: Path) -> ExternalProjector:
    """A projector that other programs drive, closed.

    Args:
        options: as in :class:`drivers.projector.options.ExternalOptions`; base_dir: where its hooks run.

    Raises:
        ValueError: "projector.KEY: ..." says what is wrong with which option.
    """
    return ExternalProjector(read(ExternalOptions, options), base_dir)
