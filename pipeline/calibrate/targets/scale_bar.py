"""The two ends of a bar of known length: the only two circles of their size in an image."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from daemon.apps.calibration.images.image_files import Image
from pipeline.calibrate.targets.detect.disc_candidates import find_discs
from pipeline.calibrate.targets.localise.ellipse_fit import fit_ellipses
from pipeline.calibrate.targets.localise.gray_image import to_grey
from pipeline.common.errors import TargetError

_LEAST_RADIUS_PX = 3.0
_SAME_SIZE = 0.5
"""Circles of less than half the largest one's area, or half its contrast, are no ends of the bar."""
_MISFIT = 0.12
_SURROUNDINGS = 0.5
_MOST_CANDIDATES = 200


def two_circles(image: Image, name: str) -> NDArray[np.float64]:
    """Centres (2, 2) of the two circles, pixels; both dark on light, or both light on dark.

    Raises:
        TargetError: there are not two that stand out from everything else.
    """
    grey = to_grey(image)
    best = 0
    for dark in (True, False):
        discs = find_discs(grey.values, dark=dark)
        discs = discs.some(discs.radii >= _LEAST_RADIUS_PX)
        if not len(discs):
            continue
        discs = discs.some(np.argsort(-discs.contrast * discs.radii)[:_MOST_CANDIDATES])
        reach = np.maximum(_SURROUNDINGS * discs.radii, 3.0)
        fits = fit_ellipses(grey.values, discs.centres, discs.shapes, reach=reach, clip=grey.clip)
        near = np.linalg.norm(fits.centres - discs.centres, axis=1) < 0.5 * discs.radii
        good = fits.good & near & (fits.misfit < _MISFIT) & (fits.areas_px > 0)
        if not good.any():
            continue
        strength = np.where(good, np.abs(fits.contrast) * fits.areas_px, 0.0)
        leader = int(strength.argmax())
        alike = good & (fits.areas_px > _SAME_SIZE * fits.areas_px[leader])
        alike &= fits.areas_px < fits.areas_px[leader] / _SAME_SIZE
        alike &= np.abs(fits.contrast) > _SAME_SIZE * np.abs(fits.contrast[leader])
        if alike.sum() == 2:
            return np.asarray(fits.centres[alike])
        best = max(best, int(alike.sum()))
    raise TargetError(
        f"{name}: {best} circles of one size stand out, the ends of a bar are two; show the bar "
        "alone, on an even ground"
    )
