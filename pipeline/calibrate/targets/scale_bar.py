"""Detection of the ends of a scale bar: the only two circles of their size in an image."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.detect.disc_candidates import find_discs
from pipeline.calibrate.targets.localise.ellipse_fit import fit_ellipses
from pipeline.calibrate.targets.localise.gray_image import to_gray
from pipeline.common.errors import TargetError

_LEAST_RADIUS_PX = 3.0
_SAME_SIZE = 0.5
"""Circles below this share of the strongest one's area or contrast are no ends of the bar."""
_MISFIT = 0.12
_SURROUNDINGS = 0.5
_MOST_CANDIDATES = 200


def two_circles(image: NDArray[Any], name: str) -> NDArray[np.float64]:
    """Centres (2, 2) of the two circles, pixels; both dark on light, or both light on dark.

    Args:
        image: (H, W) grey or (H, W, 3) red, green, blue; uint8 or uint16. name: of the image, for errors.

    Raises:
        TargetError: not exactly two circles stand out.
    """
    gray = to_gray(image)
    best = 0
    for dark in (True, False):
        discs = find_discs(gray.values, dark=dark)
        discs = discs.some(discs.radii >= _LEAST_RADIUS_PX)
        if not len(discs):
            continue
        discs = discs.some(np.argsort(-discs.contrast * discs.radii)[:_MOST_CANDIDATES])
        reach = np.maximum(_SURROUNDINGS * discs.radii, 3.0)
        fits = fit_ellipses(gray.values, discs.centres, discs.shapes, reach=reach, clip=gray.clip)
        near = np.linalg.norm(fits.centres - discs.centres, axis=1) < 0.5 * discs.radii
        good = fits.good & near & (fits.misfit < _MISFIT) & (fits.areas_px > 0)
        if not good.any():
            continue
        strength = np.where(good, np.abs(fits.contrast) * fits.areas_px, 0.0)
        strongest = int(strength.argmax())
        similar = good & (fits.areas_px > _SAME_SIZE * fits.areas_px[strongest])
        similar &= fits.areas_px < fits.areas_px[strongest] / _SAME_SIZE
        similar &= np.abs(fits.contrast) > _SAME_SIZE * np.abs(fits.contrast[strongest])
        if similar.sum() == 2:
            return np.asarray(fits.centres[similar])
        best = max(best, int(similar.sum()))
    raise TargetError(
        f"{name}: {best} circles of one size stand out, the ends of a bar are two; show the bar "
        "alone, on an even ground"
    )
