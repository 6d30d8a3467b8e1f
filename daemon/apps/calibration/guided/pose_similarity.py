"""Similarity of two poses of the board: a second similar view adds no information."""

from __future__ import annotations

import numpy as np

from pipeline.calibrate.bundle.quality.view_coverage import ViewGeometry

POSITION, SIZE, FORESHORTENING, TILT_DEG = 0.05, 0.03, 0.05, 6.0
"""Limits below which poses are similar: position as a share of the image, relative size, relative foreshortening, tilt
about either axis."""


def similar(one: ViewGeometry, other: ViewGeometry) -> bool:
    """Whether position, size and tilt are about the same."""
    shift = float(np.abs(np.subtract(one.position, other.position)).max())
    size = abs(float(np.log(one.size / other.size)))
    foreshortening = float(np.abs(one.turn - other.turn).max())
    tilt = max(abs(one.tilt_x_deg - other.tilt_x_deg), abs(one.tilt_y_deg - other.tilt_y_deg))
    # The signs of a tilt come from perspective alone and may be wrong for a nearly frontal board.
    most_tilt = TILT_DEG + 2 * _tilt_sigma_deg(one)
    return shift < POSITION and size < SIZE and foreshortening < FORESHORTENING and tilt < most_tilt


def _tilt_sigma_deg(geometry: ViewGeometry) -> float:
    """Uncertainty of the tilt: near zero the cosine changes slowly."""
    return 4.0 if geometry.tilt_deg < 10 else 1.0
