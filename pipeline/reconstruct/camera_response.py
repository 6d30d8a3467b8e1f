"""Faults of the responses that the calibration does not know: white balance, sharpness, brightness, periodic error.

The phase error of a coloured surface cancels between the cameras where both see the same colours with the same fringe
contrast. A white balance of one camera displaces every point instead, and a blur of one camera those of coloured
surfaces. Where one camera's images are brighter, by aperture, gain or exposure time, right orders have different
textures. A response of the projector or a crosstalk that differs from the calibrated one displaces both cameras' phases
alike: no point moves, but the phases disagree with the projector's. All are measured once, at matched points of the
first pair, where both cameras see the same surfaces.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.decode.decoder import PhaseMap
from pipeline.decode.pixel_descriptor import EVEN, normalised_phase, over_the_image, periodic
from pipeline.filter.texture_agreement import scale_of
from pipeline.match.match_result import PIXEL_STEPS, RESIDUAL_STEP, MatchResult
from pipeline.rig.calibration import ColorModel

F64 = NDArray[np.float64]
Image = NDArray[np.uint8]
Mask = NDArray[np.bool_]

EQUAL: F64 = np.concatenate([np.ones(5), np.zeros(6), EVEN, [1.0]])
"""Both cameras respond as calibrated: gains of R, G, B of the right camera relative to their mean, its contrast and its
brightness, relative to the left one's; coefficients of the phase's error, see :func:`.pixel_descriptor.periodic`, and
of the factor that evens out the brightness over the right image, see :func:`.pixel_descriptor.over_the_image`; share of
the texture's weight in the order search."""
CONTRAST, BRIGHTNESS, ERROR, VIGNETTING, TEXTURE = 3, 4, slice(5, 11), slice(11, 18), 18
"""Numbers of the response that follow the gains."""
CERTAINLY_UNEQUAL = 0.1
"""Relative difference from which whole images show a white balance: they do not see quite the same surfaces."""
UNEQUAL, CORRECTED = 0.015, 0.003
"""Relative difference that matched points show certainly, and that is left when it is corrected."""
BRIGHTER, CERTAINLY_BRIGHTER = 0.1, 0.15
"""Relative difference of brightness from which it is corrected, at matched points and of whole images: of cameras that
are alike these differ by less than 0.03 in 19 of 20 pairs."""
VIGNETTED, VIGNETTED_REPEATING = 0.1, 0.03
"""How much the right camera's relative brightness varies over the image when it is corrected; the second where the
fringes repeat, and textures alone distinguish orders."""
_RIDGE = 1e-3
"""Of the fit over the image, against large values where there are no points."""
TEXTURES_ALIKE = 0.05
"""Scatter of the relative difference of both images' means at matched points up to which textures have all their
weight; 0.01 to 0.04 where surfaces reflect alike in both directions."""
LAG = 2
"""Pixels to either side between which the fringes' periods in both images are compared."""
_ALIKE = 0.15
_NOTICEABLY_VIGNETTED = 0.25
_NOTICEABLE, _NOTICEABLY_BRIGHTER, _UNSHARP = 0.05, 0.25, 0.12
_DARK, _BRIGHT = 8, 225
_LEAST_POINTS = 1000
_LARGEST, _BRIGHTEST = 2.5, 8.0
_PERIODIC, _NOTICEABLY_PERIODIC, _MOST_PERIODIC = 0.02, 0.08, 0.7
"""Periodic error, rms in radians, from which it is corrected and warned of; the largest slope that is corrected: with a
slope of 1 phases would have no order any more."""
_EXPLAINED = 0.95
"""Share of the residuals' variance that the error leaves at most."""
_FIT_ROUNDS, _INLIERS = 4, 2.5
_PHASE_PARTS, _LEAST_SHARE = 8, 0.02
"""Parts of a period of which each needs this share of the points."""


def gains_of_images(left: Image, right: Image, left_valid: Mask, right_valid: Mask) -> F64:
    """Gains (3,) from the mean colours (H, W, 3) of all lit pixels, ones where they do not differ certainly."""
    if min(np.count_nonzero(left_valid), np.count_nonzero(right_valid)) < _LEAST_POINTS:
        return np.ones(3)
    ours, others = left[::2, ::2][left_valid[::2, ::2]], right[::2, ::2][right_valid[::2, ::2]]
    return _relative(others.mean(axis=0), ours.mean(axis=0), CERTAINLY_UNEQUAL)


def gains_of_points(left: Image, right: Image, match: MatchResult, least: float) -> F64:
    """Gains (3,) from colours (H, W, 3) at matched points, ones where they differ by less than ``least``."""
    rows, columns, v, u = _points(match, match.valid != 0)
    ours, others = left[rows, columns], right[v, u]
    some = (np.minimum(ours, others).min(axis=1) > _DARK) & (np.maximum(ours, others).max(axis=1) < _BRIGHT)
    if np.count_nonzero(some) < _LEAST_POINTS:
        return np.ones(3)
    return _relative(others[some].mean(axis=0), ours[some].mean(axis=0), least)


def contrast_of_points(left: PhaseMap, right: PhaseMap, match: MatchResult, axis: int) -> float:
    """Median modulation over mean in the right image, relative to the left one; 1 with too few points.

    Only surfaces whose fringes have the same period in both images count: narrower fringes have less contrast, too.

    Args:
        axis: 0 = the fringes' phase grows along u.
    """
    seen = (match.right_u, match.right_v)[axis].astype(np.int32)
    ahead, behind = (np.s_[:, 2 * LAG :], np.s_[:, : -2 * LAG]) if axis == 0 else (np.s_[2 * LAG :], np.s_[: -2 * LAG])
    middle = np.s_[:, LAG:-LAG] if axis == 0 else np.s_[LAG:-LAG]
    alike = np.zeros(seen.shape, np.bool_)
    step = np.abs(seen[ahead] - seen[behind])
    alike[middle] = np.abs(step - 2 * LAG * PIXEL_STEPS) < _ALIKE * 2 * LAG * PIXEL_STEPS
    alike[middle] &= (match.valid[ahead] & match.valid[behind] & match.valid[middle]) != 0
    rows, columns, v, u = _points(match, alike)
    if len(rows) < _LEAST_POINTS:
        return 1.0
    ours = left.modulation[rows, columns] / np.maximum(left.mean[rows, columns], 1.0)
    others = right.modulation[v, u] / np.maximum(right.mean[v, u], 1.0)
    return float(np.clip(np.median(others / np.maximum(ours, 1e-3)), 1 / _LARGEST, _LARGEST))


def brightness_of_images(left: PhaseMap, right: PhaseMap) -> float:
    """Median mean of the right image's lit pixels relative to the left one's; 1 where it hardly differs."""
    ours, others = (each.mean[::2, ::2][each.valid[::2, ::2]] for each in (left, right))
    if min(len(ours), len(others)) < _LEAST_POINTS:
        return 1.0
    return _brighter(float(np.median(others) / max(float(np.median(ours)), 1.0)), CERTAINLY_BRIGHTER)


def brightness_of_points(left: PhaseMap, right: PhaseMap, match: MatchResult) -> float:
    """Ratio of the means at matched points, right over left; 1 where it hardly differs.

    Not the median of the points' ratios: of dark surfaces, whose means are few counts, that takes few values.
    """
    ours, others, _, _ = _means_of_points(left, right, match)
    if len(ours) < _LEAST_POINTS:
        return 1.0
    ratio = others / ours
    error = np.abs(ratio - np.median(ratio))
    some = error <= _INLIERS * 1.4826 * np.median(error) + 0.02
    return _brighter(float(others[some].sum() / ours[some].sum()), BRIGHTER)


def vignetting_of_points(
    left: PhaseMap, right: PhaseMap, match: MatchResult, brightness: float, *, repeats: bool
) -> F64:
    """Coefficients (7,) of left over right mean at matched points over the right image, EVEN where it hardly varies.

    Lenses darken the corners of their images, and hardly ever alike at both images of a surface point. Surfaces that
    shine do so as well: a function with seven coefficients over the whole image follows them little.

    Args:
        brightness: of the right camera, by which its means are divided before; repeats: the fringes repeat.
    """
    ours, others, u, v = _means_of_points(left, right, match)
    if len(ours) < _LEAST_POINTS:
        return EVEN
    terms = over_the_image(u, v, right.mean.shape[::-1])
    found, _ = _fitted(terms, brightness * ours / others, _RIDGE * len(ours) * np.diag([0.0, *np.ones(6)]))
    low, high = np.quantile(terms @ found, (0.02, 0.98))
    values = _on_grid(found)
    sane = values.min() > 1 / _LARGEST and values.max() < _LARGEST
    return found if sane and high / low - 1 > (VIGNETTED_REPEATING if repeats else VIGNETTED) else EVEN


def _means_of_points(left: PhaseMap, right: PhaseMap, match: MatchResult) -> tuple[F64, F64, Any, Any]:
    """Left and right means of matched points that are neither dark nor saturated, and their right pixels u, v."""
    rows, columns, v, u = _points(match, match.valid != 0)
    ours, others = left.mean[rows, columns], right.mean[v, u]
    some = (np.minimum(ours, others) > _DARK) & (np.maximum(ours, others) < _BRIGHT)
    return ours[some].astype(np.float64), others[some].astype(np.float64), u[some], v[some]


def _on_grid(factor: F64) -> F64:
    """Values (25,) of a factor (7,) on a grid over the image."""
    u, v = np.divmod(np.arange(25), 5)
    return np.asarray(over_the_image(u, v, (5, 5)) @ factor)


def texture_share(left: PhaseMap, right: PhaseMap, match: MatchResult) -> float:
    """Share of the texture's weight in the order search: less where matched points are unlike."""
    return min(1.0, TEXTURES_ALIKE / scale_of(match, left, right).mean_sigma)


def periodic_error(left: PhaseMap, match: MatchResult) -> F64:
    """Coefficients (6,) of the normalised phase's error against the projector, zeros where it is small.

    A residual that goes with the wrapped phase, in all orders alike, is one of the response: a wrong order, another
    offset of the projector or a moved device leaves one that goes with the place.
    """
    part = np.s_[::3, ::3]  # of a mosaic pixels of every colour
    some = (match.valid[part] != 0) & (np.abs(match.residual_normalised[part]) < 0.5 / RESIDUAL_STEP)
    phase = normalised_phase(left.descriptors[part][some]).astype(np.float64)
    residual = RESIDUAL_STEP * match.residual_normalised[part][some].astype(np.float64)
    parts = np.bincount(
        (phase % (2 * np.pi) * (_PHASE_PARTS / (2 * np.pi))).astype(int) % _PHASE_PARTS, minlength=_PHASE_PARTS
    )
    if len(phase) < _LEAST_POINTS or parts.min() < _LEAST_SHARE * len(phase):
        return np.zeros(6)
    before = np.median(np.abs(residual - np.median(residual)))
    found, after = _fitted(np.column_stack([periodic(phase), np.ones_like(phase)]), residual)
    coefficients = found[:6]
    fits = rms_of(coefficients) >= _PERIODIC and _sizes(coefficients) @ (1, 2, 3) <= _MOST_PERIODIC
    return coefficients if fits and after**2 <= _EXPLAINED * before**2 else np.zeros(6)


def _fitted(terms: F64, values: F64, ridge: F64 | float = 0.0) -> tuple[F64, float]:
    """Coefficients (k,) of terms (n, k) that fit the inliers of values (n,) best, and the median error of all.

    The few terms cover a circle or an image, so that their normal equations are well conditioned.
    """
    inliers = np.ones(len(values), np.bool_)
    for _ in range(_FIT_ROUNDS):
        weighted = terms.T * inliers
        found = np.asarray(np.linalg.lstsq(weighted @ terms + ridge, weighted @ values, rcond=None)[0], np.float64)
        error = np.abs(values - terms @ found)
        median = float(np.median(error))
        inliers = error < _INLIERS * 1.4826 * median + 1e-6
    return found, median


def rms_of(error: F64) -> float:
    """Root mean square of a periodic error (6,), radians."""
    return float(np.sqrt((_sizes(error) ** 2).sum() / 2))


def scatter_of(error: F64) -> float:
    """Variance of the difference of a periodic error (6,) between places half a period apart, rad^2."""
    return float(2 * (_sizes(error)[::2] ** 2).sum())


def _sizes(error: F64) -> F64:
    """Amplitudes (3,) of the parts of a periodic error that go with one, two and three times the phase."""
    return np.hypot(error[::2], error[1::2])


def _brighter(ratio: float, least: float) -> float:
    if abs(np.log(max(ratio, 1e-3))) < np.log1p(least):
        return 1.0
    return float(np.clip(ratio, 1 / _BRIGHTEST, _BRIGHTEST))


def with_gains(color: ColorModel, gains: F64) -> ColorModel:
    """The colour model of a camera whose channels have further gains (3,)."""
    crosstalk = color.crosstalk * gains[:, None] / gains[None, :]
    return replace(color, crosstalk=crosstalk, balance=np.clip(color.balance * gains, 0.05, 3))


def warnings_of(response: F64) -> tuple[str, ...]:
    """What a user should correct at the cameras, a sentence each."""
    gains, contrast, brightness = response[:3], float(response[CONTRAST]), float(response[BRIGHTNESS])
    error = rms_of(response[ERROR])
    warnings = []
    if abs(np.log(brightness)) > np.log1p(_NOTICEABLY_BRIGHTER):
        warnings.append(
            f"the right camera's images are {brightness:.2f} times as bright as the left one's; set exposure time, "
            "gain and aperture of both alike"
        )
    factors = _on_grid(response[VIGNETTING])
    if (varies := factors.max() / factors.min() - 1) > _NOTICEABLY_VIGNETTED:
        warnings.append(
            f"the right camera's brightness relative to the left one's varies by {100 * varies:.0f} % over the image "
            "and is corrected from the images; use lenses of one type with the same aperture"
        )
    if np.abs(gains - 1).max() > _NOTICEABLE:
        ratios = ", ".join(f"{name} {gain:.2f}" for name, gain in zip(("red", "green", "blue"), gains, strict=True))
        warnings.append(
            f"the right camera's white balance is not the left one's ({ratios} relative to it) and is corrected from "
            "the images; switch automatic white balance off and calibrate the colours (fringed calibrate color)"
        )
    if abs(np.log(contrast)) > _UNSHARP:
        side = "right" if contrast < 1 else "left"
        warnings.append(
            f"the {side} camera sees the fringes with {100 * (1 - min(contrast, 1 / contrast)):.0f} % less contrast "
            "than the other one; focus its lens"
        )
    if error > _NOTICEABLY_PERIODIC:
        warnings.append(
            f"the phases have a periodic error of {error:.2f} rad, which is corrected from the images; calibrate the "
            "colours and the projector's response (fringed calibrate color)"
        )
    return tuple(warnings)


def _relative(right: F64, left: F64, least: float) -> F64:
    gains = right / np.maximum(left, 1e-3)
    gains = np.clip(gains / gains.mean(), 1 / _LARGEST, _LARGEST)
    return np.asarray(gains if np.abs(gains - 1).max() >= least else np.ones(3), dtype=np.float64)


def _points(match: MatchResult, which: Mask) -> tuple[NDArray[np.int64], ...]:
    """Rows and columns of some of these pixels (H, W), and of the right pixels that they are matched with."""
    some = which[::3, ::2] & (np.abs(match.residual_normalised[::3, ::2]) < 0.5 / RESIDUAL_STEP)
    rows, columns = np.nonzero(some)
    u, v = (plane[::3, ::2][some] // PIXEL_STEPS for plane in (match.right_u, match.right_v))
    return 3 * rows, 2 * columns, v.astype(np.int64), u.astype(np.int64)
