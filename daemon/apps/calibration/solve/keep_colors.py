"""Colours and response of an existing calibration carried over to newly calibrated cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daemon.rig.calibration_file import CamerasFile
from pipeline.rig.calibration import Cameras, ColorModel


def with_old_colors(new: Cameras, old: CamerasFile | None) -> tuple[Cameras, list[str]]:
    """The new cameras with the colours of the old file, and notes about them.

    Colours depend on sensors and lenses, not on poses, so they remain valid. The old projector's pose refers to the old
    left camera and is dropped; its response depends on its lamp and is kept with a new projector.
    """
    if old is None:
        return new, []
    before = old.cameras
    notes = []
    if (before.left.size, before.right.size) != (new.left.size, new.right.size):
        return new, ["the image size differs from that of the old file: its colours are not carried over"]
    if any(_measured(color) for color in (before.left_color, before.right_color)):
        new = replace(new, left_color=before.left_color, right_color=before.right_color)
        notes.append(
            "the colours of the old file are kept; run fringed calibrate color if the light or the lenses changed"
        )
    if new.projector is None:
        if before.projector is not None:
            notes.append("the projector of the old file does not fit the new cameras: run fringed calibrate projector")
    elif new.response is None and before.projector is not None and before.projector.size == new.projector.size:
        if before.response is not None:
            notes.append("the projector's response of the old file is kept")
        new = replace(new, response=before.response, registration=before.registration)
    return new, notes


def _measured(color: ColorModel) -> bool:
    return bool((color.black != 0).any() or (color.crosstalk != np.eye(3)).any())
