"""Response of the projector's channels: the light of every drive value, from even images of a few.

On a white board the counts above the black frame are proportional to the light, whatever albedo, distance and
vignetting are, so each level is one factor against the full one, fitted over all pixels of the white area. Crosstalk
does not matter: one colour is lit at a time. The factors are made monotone, weighted by their noise, and interpolated
by a monotone cubic (PCHIP; Fritsch and Carlson, SIAM J. Numer. Anal. 17, 238, 1980).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_planes import F32, Images, Mask
from pipeline.calibrate.color.color_sequence import Roles
from pipeline.common.errors import ImageError
from pipeline.rig.calibration import Response

Array = NDArray[np.float64]

_LEAST_SIGMA = 2e-4


@dataclass(frozen=True, slots=True, eq=False)
class LevelCurve:
    """Relative light of one channel at its drive values, and one standard deviation of each; both (n,)."""

    levels: Array
    light: Array
    sigma: Array


def level_curve(images: Images, roles: Roles, channel: int, black: F32, full: F32, area: Mask) -> LevelCurve:
    """Relative light of a channel in one camera.

    Args:
        black: (H, W, 3) black frame; full: (H, W, 3) full light above it; area: white pixels, (H, W).
    """
    reference = full[..., channel][area].astype(np.float64)
    dark = black[..., channel][area]
    levels, light, sigma = [0.0], [0.0], [_LEAST_SIGMA]
    for level, index in roles.levels[channel]:
        counts = (images.planes(index)[..., channel][area] - dark).astype(np.float64)
        share, error = proportion(counts, reference)
        levels.append(float(level))
        light.append(share)
        sigma.append(error)
    return LevelCurve(*_joined(np.array(levels), np.array(light), np.array(sigma)))


def proportion(counts: Array, reference: Array) -> tuple[float, float]:
    """Factor of least squares between two fields, without the outermost residuals, and its standard deviation."""
    keep = np.ones(len(counts), bool)
    share = 0.0
    for _ in range(3):
        share = float((counts[keep] * reference[keep]).sum() / (reference[keep] ** 2).sum())
        residual = counts - share * reference
        scatter = 1.4826 * float(np.median(np.abs(residual[keep]))) + 0.3
        keep = np.abs(residual) < 4 * scatter
    spread = float(residual[keep].std())
    return share, max(spread / float(np.sqrt((reference[keep] ** 2).sum())), _LEAST_SIGMA)


def response_of(curves: list[list[LevelCurve]]) -> Response:
    """The response from the cameras' curves, ``curves[channel]`` a list of them; at all 256 levels."""
    drive = np.arange(256.0)
    out = []
    for name, own in zip(("red", "green", "blue"), curves, strict=True):
        levels, light, sigma = _joined(*(np.concatenate(parts) for parts in zip(*map(_parts, own), strict=True)))
        rise = light[-1] - light[0]
        if not rise > 0 or np.diff(light).min() < -0.1:
            at = levels[int(np.diff(light).argmin()) + 1]
            raise ImageError(
                f"the light of {name} falls towards drive value {at:.0f}: frames and levels do not match, or "
                "the exposure is no whole number of colour cycles; take the sequence again"
            )
        # Both ends are exact by definition.
        sigma[[0, -1]] = 1e-6
        fitted = np.clip(isotonic(light, 1 / sigma**2), 0.0, 1.0)
        fitted[0], fitted[-1] = 0.0, 1.0
        curve = np.clip(monotone_cubic(levels, fitted, drive), 0.0, 1.0)
        out.append(np.maximum.accumulate(curve))
    curves_of = np.stack(out)
    curves_of[:, -1] = 1.0
    return Response(drive, curves_of)


def isotonic(values: Array, weights: Array) -> Array:
    """The nearest sequence that never falls, by weighted squares (pool adjacent violators), (n,) -> (n,)."""
    means: list[float] = []
    totals: list[float] = []
    counts: list[int] = []
    for value, weight in zip(values, weights, strict=True):
        mean, total, count = float(value), float(weight), 1
        while means and means[-1] > mean:
            last, before, n = means.pop(), totals.pop(), counts.pop()
            mean = (mean * total + last * before) / (total + before)
            total, count = total + before, count + n
        means.append(mean)
        totals.append(total)
        counts.append(count)
    return np.repeat(means, counts)


def monotone_cubic(x: Array, y: Array, at: Array) -> Array:
    """Monotone piecewise cubic through (x, y), evaluated at ``at`` inside x: PCHIP with weighted harmonic slopes."""
    h, d = np.diff(x), np.diff(y) / np.diff(x)
    slopes = np.zeros(len(x))
    if len(x) == 2:
        slopes[:] = d[0]
    else:
        w1, w2 = 2 * h[1:] + h[:-1], h[1:] + 2 * h[:-1]
        least = 1e-12 * float(np.abs(d).max())
        rising = (d[1:] > least) & (d[:-1] > least)
        safe = np.where(rising, d[:-1], 1.0), np.where(rising, d[1:], 1.0)
        slopes[1:-1] = np.where(rising, (w1 + w2) / (w1 / safe[0] + w2 / safe[1]), 0.0)
        slopes[0] = _end_slope(h[0], h[1], d[0], d[1])
        slopes[-1] = _end_slope(h[-1], h[-2], d[-1], d[-2])
    i = np.clip(np.searchsorted(x, at, side="right") - 1, 0, len(x) - 2)
    t = (at - x[i]) / h[i]
    return np.asarray(
        (1 + 2 * t) * (1 - t) ** 2 * y[i] + t * (1 - t) ** 2 * h[i] * slopes[i]
        + t**2 * (3 - 2 * t) * y[i + 1] + t**2 * (t - 1) * h[i] * slopes[i + 1]
    )  # fmt: skip


def _end_slope(h0: float, h1: float, d0: float, d1: float) -> float:
    """Three-point slope at an end, kept monotone."""
    slope = ((2 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    if slope * d0 <= 0:
        return 0.0
    return 3 * d0 if d0 * d1 < 0 and abs(slope) > abs(3 * d0) else float(slope)


def _parts(curve: LevelCurve) -> tuple[Array, Array, Array]:
    return curve.levels, curve.light, curve.sigma


def _joined(levels: Array, light: Array, sigma: Array) -> tuple[Array, Array, Array]:
    """Values of the same level joined by their weights, in rising order."""
    distinct = np.unique(levels)
    weights = [1 / sigma[levels == level] ** 2 for level in distinct]
    means = [float((w * light[levels == level]).sum() / w.sum()) for level, w in zip(distinct, weights, strict=True)]
    return distinct, np.array(means), np.array([float(w.sum() ** -0.5) for w in weights])
