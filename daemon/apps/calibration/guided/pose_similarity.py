"""Whether two places of the board are so alike that the second adds nothing."""

from __future__ import annotations

import numpy as np

from pipeline.calibrate.bundle.quality.view_coverage import ViewGeometry

PLACE, SIZE, TURN, TILT_DEG = 0.05, 0.03, 0.05, 6.0
"""Poses that differ by less in all of these are alike: place as a share of the image, size (relative), foreshortening
(relative), tilt about either axis."""


def alike(one: ViewGeometry, other: ViewGeometry) -> bool:
    """Whether place, size and tilt are about the same."""
    place = float(np.abs(np.subtract(one.position, other.position)).max())
    size = abs(float(np.log(one.size / other.size)))
    turn = float(np.abs(one.turn - other.turn).max())
    tilt = max(abs(one.tilt_x_deg - other.tilt_x_deg), abs(one.tilt_y_deg - other.tilt_y_deg))
    # The signs of a tilt come from perspective alone and may be wrong where the board is nearly flat on.
    return place < PLACE and size < SIZE and turn < TURN and tilt < TILT_DEG + 2 * _flatness_deg(one)


def _flatness_deg(look: ViewGeometry) -> float:
    """How uncertain the tilt is: near zero, cos changes slowly."""
    return 4.0 if look.tilt_deg < 10 else 1.0
