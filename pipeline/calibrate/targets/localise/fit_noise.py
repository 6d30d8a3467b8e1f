"""Estimation of an image's noise from the residuals of a fit."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.localise.gray_image import GrayPlane

Array = NDArray[np.float64]

_FAR_FROM = 8
"""Half side of a block from which on neighbours two pixels apart are counted too."""
_LEAST_HALF = 4
_LEAST_SAMPLES = 30
_MOST_BLOCKS = 12
_MAX_VARIANCE_RATIO = 3.0


def noise_line(dark: tuple[float, float, float], light: tuple[float, float, float]) -> Array:
    """Variance of a sample as a line over its intensity I: ``line[0] + line[1] * max(I, 0)`` (read and shot noise).

    Args:
        dark, light: intensity, sum of squared residuals, number of samples; of the dark and the light flat parts.
    """
    variance = [max(total, 0.0) / max(count, 1.0) for _, total, count in (dark, light)]
    floor = max(1e-3 * max(variance), 1e-12)
    rise = light[0] - dark[0]
    if min(dark[2], light[2]) < _LEAST_SAMPLES or rise <= 0 or variance[1] <= variance[0]:
        counted = [v for v, part in zip(variance, (dark, light), strict=True) if part[2] >= _LEAST_SAMPLES] or variance
        return np.array([max(float(np.mean(counted)), floor), 0.0])
    slope = (variance[1] - variance[0]) / rise
    at_zero = variance[0] - slope * max(dark[0], 0.0)
    if at_zero < floor:
        slope, at_zero = (variance[1] - floor) / max(light[0], 1e-12), floor
    return np.array([at_zero, slope])


def noise_correlation(values: GrayPlane, centres: Array, halves: Array) -> float:
    """Sum of the noise's autocorrelation over the nearest pixels: 1 for white noise, 2 or more after demosaicing.

    A mean over many pixels is that much less certain than the variance of one pixel promises.

    Args:
        values: (H, W) the image.
        centres: (n, 2) pixels, middles of blocks in which nothing but noise and a plane of light is expected.
        halves: (n,) half sides of the blocks, pixels; blocks under 4 are not used.
    """
    sums = []
    for (u, v), half in zip(np.round(centres).astype(int), np.floor(halves).astype(int), strict=True):
        if half < _LEAST_HALF or min(u, v) < half:
            continue
        block = values[v - half : v + half + 1, u - half : u + half + 1]
        if block.shape == (2 * half + 1, 2 * half + 1):
            sums.append(_sums(_flat(block.astype(np.float64)), 2 if half >= _FAR_FROM else 1))
        if len(sums) >= _MOST_BLOCKS:
            break
    if not sums:
        return 1.0
    summed, variance = np.array(sums).T
    plain = variance <= _MAX_VARIANCE_RATIO * np.median(variance)
    total = float(variance[plain].sum())
    return float(np.clip(summed[plain].sum() / total, 1.0, 25.0)) if total > 0 else 1.0


def _sums(block: Array, lags: int) -> tuple[float, float]:
    """Sum of the autocovariance over the lags, and the variance; both as if no plane had been taken away."""
    height, width = block.shape
    total = 0.0
    for dv in range(-lags, lags + 1):
        for du in range(-lags, lags + 1):
            a = block[max(dv, 0) : height + min(dv, 0), max(du, 0) : width + min(du, 0)]
            b = block[max(-dv, 0) : height + min(-dv, 0), max(-du, 0) : width + min(-du, 0)]
            total += float((a * b).mean())
    # The plane's three parameters take 3 / n of the power out of every lag.
    removed = 3 / block.size
    return total / (1 - removed * (2 * lags + 1) ** 2), float((block * block).mean()) / (1 - removed)


def _flat(block: Array) -> Array:
    """A block minus its plane."""
    v, u = (axis.ravel() for axis in np.mgrid[0 : block.shape[0], 0 : block.shape[1]].astype(np.float64))
    basis = np.stack([np.ones_like(u), u, v], axis=1)
    return block - (basis @ np.linalg.lstsq(basis, block.ravel(), rcond=None)[0]).reshape(block.shape)
