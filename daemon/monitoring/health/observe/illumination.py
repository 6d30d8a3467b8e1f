"""The light of some of the pairs: clipped samples, fringe amplitude and coverage, as quantities."""

from __future__ import annotations

import math

import numpy as np

from daemon.live.items import CloudItem
from daemon.monitoring.health.quantities import CHANNELS
from drivers.protocols import SIDES
from pipeline.monitor.illumination import LINES, Lighting, fringe_period_px, lighting
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration

_LIT = 5


class Light:
    """Looks at pairs of one rig.

    Args:
        calibration, pattern: tell how wide the fringes are in the images.
    """

    def __init__(self, calibration: Calibration, pattern: ColorFringe) -> None:
        self._period_px, self._axis = fringe_period_px(calibration, pattern), pattern.axis

    def values(self, item: CloudItem) -> dict[str, float]:
        """Everything that one pair tells; takes about a millisecond."""
        out = {"coverage_lit": _coverage(item)}
        for side, frame, modulation in zip(SIDES, (item.left, item.right), item.cloud.modulation, strict=True):
            seen = lighting(
                frame.image, frame.encoding, modulation, period_px=self._period_px, stride=item.stride, axis=self._axis
            )
            out |= _named(side, seen)
        return out


def _named(side: str, seen: Lighting) -> dict[str, float]:
    out = {f"saturated_{side}": max(seen.saturated)}
    known = [value for value in seen.amplitude if not math.isnan(value)]
    out[f"modulation_{side}"] = min(known) if known else math.nan
    if len(seen.saturated) == len(CHANNELS):
        out |= {f"saturated_{side}_{c}": value for c, value in zip(CHANNELS, seen.saturated, strict=True)}
        out |= {f"modulation_{side}_{c}": value for c, value in zip(CHANNELS, seen.amplitude, strict=True)}
    return out


def _coverage(item: CloudItem) -> float:
    """Share of the pixels with fringes that have a point, on some lines."""
    height = item.cloud.gray.shape[0]
    rows = np.linspace(0, height - 1, min(LINES, height) + 2)[1:-1].astype(int)
    lit = item.cloud.modulation[0][rows] >= _LIT
    known = np.isfinite(item.cloud.xyz[rows, :, 2])
    there = int(np.count_nonzero(lit))
    return float(np.count_nonzero(known & lit)) / there if there else math.nan
