"""Robust averages and fits with standard deviations estimated from the scatter."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pipeline.common.median import median

F64 = NDArray[np.float64]

_PASSES = 4
_TUNING = 2.5  # scales from which the weight of a residual decreases (Huber)


def scale_of(residuals: F64) -> float:
    """Standard deviation of the bulk: 1.4826 times the median of the absolute values."""
    return 1.4826 * median(np.abs(residuals)) + 1e-12


def means(values: F64) -> tuple[F64, F64]:
    """Huber mean of every column of (n, k) and its standard deviation, (k,) each."""
    centre = np.median(values, axis=0)
    for _ in range(_PASSES):
        deviation = np.abs(values - centre)
        scale = 1.4826 * np.median(deviation, axis=0) + 1e-12
        weights = np.minimum(1.0, _TUNING * scale / np.maximum(deviation, 1e-12))
        centre = (weights * values).sum(axis=0) / weights.sum(axis=0)
    spread = ((weights * (values - centre)) ** 2).sum(axis=0)
    return centre, np.sqrt(spread) / weights.sum(axis=0)


def fit(design: F64, values: F64) -> tuple[F64, F64] | None:
    """Huber regression of (n,) on (n, k): coefficients and standard deviations, or None where it is singular.

    The covariance is the sandwich ``(X'WX)^-1 X'W diag(e^2) W X (X'WX)^-1`` (White, Econometrica 48, 817, 1980): it
    holds for heteroscedastic residuals.
    """
    weights = np.ones(len(values))
    solution: F64 = np.zeros(design.shape[1])
    for _ in range(_PASSES):
        weighted = design * weights[:, None]
        normal = weighted.T @ design
        if np.linalg.cond(normal) > 1e10:
            return None
        solution = np.asarray(np.linalg.solve(normal, weighted.T @ values), dtype=np.float64)
        residuals = values - design @ solution
        weights = np.minimum(1.0, _TUNING * scale_of(residuals) / np.maximum(np.abs(residuals), 1e-12))
    weighted = design * weights[:, None]
    inverse = np.linalg.inv(weighted.T @ design)
    middle = (weighted * residuals[:, None] ** 2).T @ weighted
    covariance = inverse @ middle @ inverse
    return solution, np.sqrt(np.maximum(np.diag(covariance), 0.0))
