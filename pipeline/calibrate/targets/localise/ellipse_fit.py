"""Maximum-likelihood localisation of circles: a blurred ellipse is fitted to the intensities around each.

The weights come from the image's noise, measured separately in dark and bright parts (shot noise), so that the
covariance of the fit is that of the centre; correlated noise of neighbouring pixels (demosaicing) is included.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.localise.ellipse_kernel import PARAMETERS, fit_all
from pipeline.calibrate.targets.localise.fit_noise import noise_correlation, noise_line
from pipeline.calibrate.targets.localise.gray_image import GrayPlane, image_noise

Array = NDArray[np.float64]

_FIRST_STEPS, _LAST_STEPS = 14, 6
_BLUR = np.array([1.0, 1.0])
"""Prior of the edges' sigma: mean and standard deviation, pixels."""
_BLUR_ALIKE = np.array([1.0, 0.2])
"""The same in shares of the median over the discs of the image."""


LEAST_SIGMA_PX = 5e-4
"""Lower bound of a centre's standard deviation: below it the error of the edge model is larger."""
_TAIL = 2.0
"""Extent of an edge's blur, in sigmas."""
_LEAST_REACH = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Fits:
    """Fits of discs, one row each; ``good`` marks the rows that hold a fit.

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


def fit_ellipses(
    values: GrayPlane,
    centres: Array,
    shapes: Array,
    *,
    reach: Array,
    clearance: Array | None = None,
    clip: float = np.inf,
) -> Fits:
    """Fit every disc.

    Args:
        values: (H, W) float32.
        centres, shapes: (n, 2) and (n, 2, 2), where to begin: within about a quarter of the radius.
        reach: (n,) pixels beyond the edge that belong to the disc's surroundings alone.
        clearance: (n,) pixels between the edge and any other edge, such as that of the paper, whose blur is kept out
            of the fit. None = there is none.
        clip: samples from this value on are saturated; they bound the light only from below.
    """
    n = len(centres)
    parameters, results = np.zeros((n, PARAMETERS)), np.zeros((n, 10))
    starts = np.ascontiguousarray(centres, dtype=np.float64)
    shapes = np.ascontiguousarray(shapes, dtype=np.float64)
    reach = np.ascontiguousarray(reach, dtype=np.float64)
    noise = np.array([max(image_noise(values) ** 2, 1e-8 * float(np.ptp(values)) ** 2, 1e-30), 0.0])
    fit_all(values, starts, shapes, reach, noise, _BLUR, clip, _FIRST_STEPS, parameters, results)
    good = results[:, 9] > 0
    if good.any():
        noise = _noise(parameters[good], results[good])
        sigma = float(np.median(parameters[good, 5]))
        parameters[~good] = 0
        if clearance is not None:
            reach = np.maximum(np.minimum(reach, clearance - _TAIL * sigma), _LEAST_REACH)
        fit_all(values, starts, shapes, reach, noise, sigma * _BLUR_ALIKE, clip, _LAST_STEPS, parameters, results)
        good = results[:, 9] > 0
    return _fits(values, starts, parameters, results, good)


def warm_up() -> None:
    """Compile (or load) the kernel: for no disc, because the types of the arguments are enough."""
    values, numbers = np.zeros((1, 1), np.float32), np.zeros(0)
    rows = np.zeros((0, PARAMETERS)), np.zeros((0, 10))
    fit_all(values, np.zeros((0, 2)), np.zeros((0, 2, 2)), numbers, np.zeros(2), _BLUR, np.inf, 0, *rows)


def _noise(parameters: Array, results: Array) -> Array:
    ground, disc = np.median(parameters[:, 6]), np.median(parameters[:, 6] - parameters[:, 9])
    inside = float(disc), float(results[:, 5].sum()), float(results[:, 6].sum())
    outside = float(ground), float(results[:, 7].sum()), float(results[:, 8].sum())
    return noise_line(inside, outside) if disc < ground else noise_line(outside, inside)


def _fits(values: GrayPlane, starts: Array, parameters: Array, results: Array, good: NDArray[np.bool_]) -> Fits:
    p = parameters
    shapes = np.stack([np.stack([p[:, 2], p[:, 3]], axis=1), np.stack([p[:, 3], p[:, 4]], axis=1)], axis=1)
    centres = starts + p[:, :2]
    total = results[:, 5] + results[:, 7]
    samples = np.maximum(results[:, 6] + results[:, 8], 1)
    misfit = np.sqrt(total / samples) / np.maximum(np.abs(p[:, 9]), 1e-12)
    # Correlated noise of neighbouring pixels averages out less than the covariance assumes.
    inner = 0.5 * (p[:, 2] + p[:, 4] - np.hypot(p[:, 2] - p[:, 4], 2 * p[:, 3])) - 4 * p[:, 5]
    spread = np.linspace(0, good.sum() - 1, min(int(good.sum()), 24)).astype(int)
    correlation = noise_correlation(values, centres[good][spread], (inner / np.sqrt(2))[good][spread])
    variance = 0.5 * (results[:, 0] + results[:, 1]) * results[:, 3] * correlation
    return Fits(
        centres, shapes, np.sqrt(np.maximum(variance, LEAST_SIGMA_PX**2)), p[:, 5], p[:, 9], p[:, 6], misfit, good
    )
