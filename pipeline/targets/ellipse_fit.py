"""Centres of circles' images by maximum likelihood: a blurred ellipse is fitted to the intensities around each.

The weights come from the picture's own noise, dark and bright measured apart (shot noise), so that the covariance of
the fit is the standard deviation of the centre that the noise really causes; noise of neighbouring pixels that goes
together (demosaicing) is counted too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.targets.ellipse_kernel import PARAMETERS, fit_all
from pipeline.targets.grey import Grey, picture_noise

Array = NDArray[np.float64]

_FIRST_STEPS, _LAST_STEPS = 14, 6
_BLUR = np.array([1.0, 1.0])
"""What is known of the edges' sigma before anything was seen: mean and standard deviation, pixels."""
_BLUR_ALIKE = np.array([1.0, 0.2])
"""The same in shares of the median over the discs of the picture."""
_SAMPLED = 12
_LAGS = 2


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """What was fitted, one row a disc; ``good`` tells which rows hold a fit.

    Args:
        centres: (n, 2) pixels, centre of the ellipse = centroid of its area.
        shapes: (n, 2, 2) radius matrices, pixels.
        sigma_px: (n,) standard deviation of each coordinate (root mean square of the two).
        blur_px: (n,) sigma of the edges, pixels, the pixels' own aperture included.
        contrast: (n,) ground minus disc; negative for a light disc on a dark ground.
        level: (n,) of the ground.
        misfit: (n,) rms of the residuals as a share of the contrast.
        good: (n,).
    """

    centres: Array
    shapes: Array
    sigma_px: Array
    blur_px: Array
    contrast: Array
    level: Array
    misfit: Array
    good: NDArray[np.bool_]

    @property
    def areas_px(self) -> Array:
        """(n,) square pixels, corrected for the blur."""
        return np.pi * np.linalg.det(self.shapes)


def fit_ellipses(values: Grey, centres: Array, shapes: Array, *, reach: Array, clip: float = np.inf) -> Fits:
    """Fit every disc.

    Args:
        values: (H, W) float32.
        centres, shapes: (n, 2) and (n, 2, 2), where to begin: within about a quarter of the radius.
        reach: (n,) pixels beyond the edge that belong to the disc's surroundings alone.
        clip: samples from here on are clipped: they tell only that the light was at least that.
    """
    n = len(centres)
    parameters, results = np.zeros((n, PARAMETERS)), np.zeros((n, 10))
    starts = np.ascontiguousarray(centres, dtype=np.float64)
    shapes = np.ascontiguousarray(shapes, dtype=np.float64)
    reach = np.ascontiguousarray(reach, dtype=np.float64)
    noise = np.array([max(picture_noise(values) ** 2, 1e-8 * float(np.ptp(values)) ** 2, 1e-30), 0.0])
    fit_all(values, starts, shapes, reach, noise, _BLUR, clip, _FIRST_STEPS, parameters, results)
    good = results[:, 9] > 0
    if good.any():
        noise = _noise(parameters[good], results[good])
        sigma = float(np.median(parameters[good, 5]))
        parameters[~good] = 0
        fit_all(values, starts, shapes, reach, noise, sigma * _BLUR_ALIKE, clip, _LAST_STEPS, parameters, results)
        good = results[:, 9] > 0
    return _fits(values, starts, parameters, results, good)


def _noise(parameters: Array, results: Array) -> Array:
    """Variance of a sample as a line over its intensity, from the residuals inside and outside the discs."""
    inside, outside = results[:, 5].sum() / max(results[:, 6].sum(), 1), results[:, 7].sum() / max(results[:, 8].sum(), 1)
    if results[:, 6].sum() < 30 or results[:, 8].sum() < 30:
        return np.array([max(inside, outside, 1e-12), 0.0])
    bright, dark = np.median(parameters[:, 6]), np.median(parameters[:, 6] - parameters[:, 9])
    floor = max(1e-3 * max(inside, outside), 1e-12)
    slope = max((outside - inside) / (bright - dark), 0.0) if bright != dark else 0.0
    slope = min(slope, (max(inside, outside) - floor) / max(bright, dark, 1e-12))
    at_zero = max(inside - slope * max(dark, 0.0), floor) if slope > 0 else 0.5 * (inside + outside)
    return np.array([max(at_zero, floor), slope])


def _fits(values: Grey, starts: Array, parameters: Array, results: Array, good: NDArray[np.bool_]) -> Fits:
    p = parameters
    shapes = np.stack([np.stack([p[:, 2], p[:, 3]], axis=1), np.stack([p[:, 3], p[:, 4]], axis=1)], axis=1)
    centres = starts + p[:, :2]
    total = results[:, 5] + results[:, 7]
    samples = np.maximum(results[:, 6] + results[:, 8], 1)
    misfit = np.sqrt(total / samples) / np.maximum(np.abs(p[:, 9]), 1e-12)
    # Noise that goes together in neighbouring pixels averages out less than the covariance believes.
    together = _together(values, centres[good], p[good]) if good.any() else 1.0
    variance = 0.5 * (results[:, 0] + results[:, 1]) * results[:, 3] * together
    return Fits(centres, shapes, np.sqrt(np.maximum(variance, 0)), p[:, 5], p[:, 9], p[:, 6], misfit, good)


def _together(values: Grey, centres: Array, parameters: Array) -> float:
    """Sum of the noise's autocorrelation over the nearest pixels: 1 for white noise; from the middle of the discs.

    The middle of a disc and nothing else is used, minus its own plane; too small discs tell nothing.
    """
    chosen = np.linspace(0, len(centres) - 1, min(len(centres), _SAMPLED)).astype(int)
    products = np.zeros((2 * _LAGS + 1, 2 * _LAGS + 1))
    for i in chosen:
        p = parameters[i]
        inner = 0.5 * (p[2] + p[4] - np.hypot(p[2] - p[4], 2 * p[3])) - 4 * p[5]
        half = int(inner / np.sqrt(2))
        u, v = np.round(centres[i]).astype(int)
        if half < 4 or min(u, v) < half:
            continue
        block = values[v - half : v + half + 1, u - half : u + half + 1].astype(np.float64)
        if block.shape != (2 * half + 1, 2 * half + 1):
            continue
        block = _flat(block)
        for dv in range(-_LAGS, _LAGS + 1):
            for du in range(-_LAGS, _LAGS + 1):
                a = block[max(dv, 0) : block.shape[0] + min(dv, 0), max(du, 0) : block.shape[1] + min(du, 0)]
                b = block[max(-dv, 0) : block.shape[0] + min(-dv, 0), max(-du, 0) : block.shape[1] + min(-du, 0)]
                products[dv + _LAGS, du + _LAGS] += (a * b).mean()
    whole = products[_LAGS, _LAGS]
    return float(np.clip(products.sum() / whole, 1.0, 25.0)) if whole > 0 else 1.0


def _flat(block: Array) -> Array:
    """A block minus its plane."""
    v, u = (axis.ravel() for axis in np.mgrid[0 : block.shape[0], 0 : block.shape[1]].astype(np.float64))
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    return block - (basis @ np.linalg.lstsq(basis, block.ravel(), rcond=None)[0]).reshape(block.shape)
