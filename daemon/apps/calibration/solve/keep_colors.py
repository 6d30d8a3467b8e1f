"""What of an older calibration stays true beside newly found cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from daemon.rig.calibration_file import CamerasFile
from pipeline.rig.calibration import Cameras, ColorModel


def with_old_colors(new: Cameras, old: CamerasFile | None) -> tuple[Cameras, list[str]]:
    """The new cameras with the colours of the old file, and what there is to say about it.

    Colours belong to sensors and lenses, not to where they stand: they stay. The old projector does not: its pose
    was found in the world of the old left camera. Its response belongs to its lamp and stays with a new projector.
    """
    if old is None:
        return new, []
    before = old.cameras
    notes = []
    sides = ("left", "right")
    if any(getattr(before, side).size != getattr(new, side).size for side in sides):
        return new, ["the images have another size than before: the old colours are not taken over"]
    if any(_measured(color) for color in (before.left_color, before.right_color)):
        new = replace(new, left_color=before.left_color, right_color=before.right_color)
        notes.append("the colours of the old file stay; run fringed calibrate color if the light or the lenses changed")
    if new.projector is None:
        if before.projector is not None:
            notes.append("the projector of the old file does not fit the new cameras: run fringed calibrate projector")
    elif new.response is None and before.projector is not None and before.projector.size == new.projector.size:
        if before.response is not None:
            notes.append("the response of the projector in the old file stays")
        new = replace(new, response=before.response, registration=before.registration)
    return new, notes


def _measured(color: ColorModel) -> bool:
    return bool((color.black != 0).any() or (color.crosstalk != np.eye(3)).any())
