"""The views in which fringe orders are searched: the measuring volume with a margin, seen from both cameras.

Without the margin a surface outside the volume gets the best of the orders inside it. Where its phase is ambiguous, a
bare wall for example, both cameras agree on that order and the false surface passes every test.
"""

from __future__ import annotations

import numpy as np

from pipeline.common.errors import CalibrationError
from pipeline.common.settings import Settings
from pipeline.geometry.view_tables import View
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

MAX_LABELS = 64
_LEAST_MARGIN = 0.05


def search_views(
    calibration: Calibration, pattern: ColorFringe, volume: Volume, settings: Settings
) -> tuple[View, View]:
    """Views of both cameras whose orders are searched in the volume and its margin.

    The margin is halved, and at last left out, where more than MAX_LABELS orders would fit or the right camera would
    not see all of it.

    Raises:
        CalibrationError: even the volume itself is too large.
    """
    swapped, rights = calibration.swapped(), volume_of_right(calibration, volume)
    margin = settings.search_margin
    while True:
        wide = volume.widened(margin)
        try:
            wide_right = volume_of_right(calibration, wide)
            left = View.of(calibration, pattern, wide, settings, measured=volume)
            # The right view only confirms the left one: fewer rows suffice.
            right = View.of(
                swapped, pattern, wide_right, settings, inside=(swapped.right, wide), coarser=2, measured=rights
            )  # fmt: skip
        except CalibrationError:
            if margin == 0:
                raise
        else:
            labels = max(left.labels, right.labels)
            if labels <= MAX_LABELS:
                return left, right
            if margin == 0:
                raise CalibrationError(
                    f"up to {labels} fringe orders fit into the volume {volume.near_mm} .. {volume.far_mm} mm, limit "
                    f"{MAX_LABELS}; make the volume smaller or use fewer periods"
                )
        margin = margin / 2 if margin > _LEAST_MARGIN else 0.0


def volume_of_right(calibration: Calibration, volume: Volume) -> Volume:
    """Limits along the right camera's z axis that hold the whole measuring volume of the left one."""
    width, height = calibration.left.size
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    rays = np.concatenate([calibration.left.normalise(corners), np.ones((4, 1))], axis=1)
    points = np.concatenate([rays * volume.near_mm, rays * volume.far_mm])
    z = (points @ calibration.right.rotation.T + calibration.right.translation)[:, 2]
    if z.min() <= 0:
        raise CalibrationError(
            "part of the measuring volume lies behind the right camera; check its pose and the volume"
        )
    return Volume(float(z.min()), float(z.max()))
