"""Maximum-likelihood localisation of chessboard corners: a blurred crossing fitted to the intensities around each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.localise.corner_kernel import PARAMETERS, fit_corners
from pipeline.calibrate.targets.localise.ellipse_fit import LEAST_SIGMA_PX
from pipeline.calibrate.targets.localise.fit_noise import noise_correlation, noise_line
from pipeline.calibrate.targets.localise.gray_image import GrayImage, image_noise

Array = NDArray[np.float64]

_FIRST_STEPS, _LAST_STEPS = 15, 8
_BLUR, _BLUR_ALIKE = np.array([1.0, 1.0]), np.array([1.0, 0.3])
_NEAREST = 9
_SAMPLE = 24


@dataclass(frozen=True, slots=True, eq=False)
class CornerFits:
    """Fits of corners, one row each.

    Args:
        centres: (n, 2) pixels.
        sigma_px: (n,) standard deviation of each coordinate.
        blur_px: (n,) sigma of the edges, pixels.
        contrast: (n,) light minus dark.
        level: (n,) of the light squares.
        light_first: (n,) whether the quadrant between the two growing board axes is a light one.
        misfit: (n,) rms of the residuals as a share of the contrast.
        good: (n,).
    """

    centres: Array
    sigma_px: Array
    blur_px: Array
    contrast: Array
    level: Array
    light_first: NDArray[np.bool_]
    misfit: Array
    good: NDArray[np.bool_]


def fit_crossings(image: GrayImage, corners: Array, at: Array, *, reach: float) -> CornerFits:
    """Fit every corner.

    Args:
        image: grey.
        corners: (n, 2) pixels, within about two pixels.
        at: (n, 2) positions on the board in squares, which give the directions of the edges.
        reach: radius of the pixels to use, as a share of the shorter side of a square; at most 0.45.
    """
    values, n = image.values, len(corners)
    steps = _steps(corners, at)
    side = np.linalg.norm(steps, axis=1).min(axis=1)
    windows = np.clip(reach * side, 2.5, 16.0)
    parameters, results = np.zeros((n, PARAMETERS)), np.zeros((n, 10))
    # Edge 1 runs along the rows, so that its normal has the sign of the step in the columns, and the other way round.
    for column, along, across in ((2, 0, 1), (3, 1, 0)):
        normal = np.stack([-steps[:, 1, along], steps[:, 0, along]], axis=1)
        normal *= np.sign((normal * steps[:, :, across]).sum(axis=1))[:, None]
        parameters[:, column] = np.arctan2(normal[:, 1], normal[:, 0])
    parameters[:, 4] = 1.0
    starts = np.ascontiguousarray(corners, dtype=np.float64)
    first = parameters.copy()
    noise = np.array([max(image_noise(values) ** 2, 1e-8 * float(np.ptp(values)) ** 2, 1e-30), 0.0])
    fit_corners(values, starts, windows, noise, _BLUR, image.clip, _FIRST_STEPS, parameters, results)
    good = results[:, 9] > 0
    if good.any():
        noise = _noise(parameters[good], results[good])
        blur = float(np.median(parameters[good, 4])) * _BLUR_ALIKE
        parameters[~good] = first[~good]
        fit_corners(values, starts, windows, noise, blur, image.clip, _LAST_STEPS, parameters, results)
        good = results[:, 9] > 0
    # The middle of a black square holds only noise; a light one may hold a marker.
    black = np.flatnonzero(good & (parameters[:, 8] < 0))[:_SAMPLE]
    correlation = noise_correlation(values, starts[black] + steps[black].sum(axis=2) / 2, 0.25 * side[black])
    variance = 0.5 * (results[:, 0] + results[:, 1]) * results[:, 3] * correlation
    contrast = 2 * np.abs(parameters[:, 8])
    flat = np.maximum(results[:, 6] + results[:, 8], 1)
    misfit = np.sqrt((results[:, 5] + results[:, 7]) / flat) / np.maximum(contrast, 1e-12)
    return CornerFits(
        starts + parameters[:, :2],
        np.sqrt(np.maximum(variance, LEAST_SIGMA_PX**2)),
        parameters[:, 4],
        contrast,
        parameters[:, 5] + 0.5 * contrast,
        parameters[:, 8] > 0,
        misfit,
        good,
    )


def warm_up() -> None:
    """Compile (or load) the kernel: for no corner, because the types of the arguments are enough."""
    values, numbers = np.zeros((1, 1), np.float32), np.zeros(0)
    rows = np.zeros((0, PARAMETERS)), np.zeros((0, 10))
    fit_corners(values, np.zeros((0, 2)), numbers, np.zeros(2), _BLUR, np.inf, 0, *rows)


def _noise(parameters: Array, results: Array) -> Array:
    middle, half = np.median(parameters[:, 5]), np.median(np.abs(parameters[:, 8]))
    dark = float(middle - half), float(results[:, 5].sum()), float(results[:, 6].sum())
    return noise_line(dark, (float(middle + half), float(results[:, 7].sum()), float(results[:, 8].sum())))


def _steps(corners: Array, at: Array) -> Array:
    """(n, 2, 2) pixels per square at each corner: ``[:, :, 0]`` along the rows, ``[:, :, 1]`` along the columns."""
    steps = np.empty((len(corners), 2, 2))
    for index in range(len(corners)):
        near = np.argsort(np.linalg.norm(at - at[index], axis=1), kind="stable")[:_NEAREST]
        basis = np.column_stack([at[near] - at[index], np.ones(len(near))])
        steps[index] = np.linalg.lstsq(basis, corners[near], rcond=None)[0][:2].T
    return steps
