"""Illumination of some of the pairs: saturated samples, fringes and coverage, as quantities."""

from __future__ import annotations

import math

import numpy as np

from daemon.live.items import CloudItem
from daemon.monitoring.health.quantities import CHANNELS
from drivers.protocols import SIDES
from pipeline.monitor.illumination import ImageIllumination, measure_illumination
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.fringe_width import fringe_period_px
from pipeline.rig.calibration import Calibration

_LIT = 5
_ROWS = 4
"""Every so many rows are examined for fringes and points: an object of more rows is not missed."""


class Illumination:
    """Evaluates the illumination of pairs of one rig.

    Args:
        calibration, pattern: give the fringe period in the images.
    """

    def __init__(self, calibration: Calibration, pattern: ColorFringe) -> None:
        self._period_px, self._axis = fringe_period_px(calibration, pattern), pattern.axis

    def values(self, item: CloudItem) -> dict[str, float]:
        """Return the quantities of one pair; takes about a millisecond."""
        out = {"coverage_lit": _coverage(item)}
        for side, frame, modulation in zip(SIDES, (item.left, item.right), item.measured.modulation, strict=True):
            result = measure_illumination(
                frame.image, frame.encoding, modulation, period_px=self._period_px, stride=item.stride, axis=self._axis
            )
            out |= _quantities(side, result)
            out[f"lit_share_{side}"] = float(np.mean(modulation[::_ROWS] >= _LIT))
        return out


def _quantities(side: str, result: ImageIllumination) -> dict[str, float]:
    out = {f"saturated_{side}": max(result.saturated)}
    known = [value for value in result.amplitude if not math.isnan(value)]
    out[f"modulation_{side}"] = min(known) if known else math.nan
    if len(result.saturated) == len(CHANNELS):
        out |= {f"saturated_{side}_{c}": value for c, value in zip(CHANNELS, result.saturated, strict=True)}
        out |= {f"modulation_{side}_{c}": value for c, value in zip(CHANNELS, result.amplitude, strict=True)}
    return out


def _coverage(item: CloudItem) -> float:
    """Return the share of the pixels with fringes that have a point, in some rows."""
    lit = item.measured.modulation[0][::_ROWS] >= _LIT
    valid = np.isfinite(item.measured.xyz[::_ROWS, :, 2])
    count = int(np.count_nonzero(lit))
    return float(np.count_nonzero(valid & lit)) / count if count else math.nan
