"""Levenberg-Marquardt on the normal equations, with a robust loss.

The normal equations are summed image by image; they have about 36 unknowns for three devices and 6 a view, which a
dense Cholesky factorisation solves in a millisecond.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.parameterisation import GAUGE_WEIGHT, LOOSE, Parameterisation
from pipeline.calibrate.bundle.adjust.projection import project, project_with_slopes
from pipeline.calibrate.bundle.adjust.state import PER_DEVICE, PER_VIEW, State

Array = NDArray[np.float64]

MOST_STEPS = 60
_FIRST_DAMPING, _MOST_DAMPING = 1e-4, 1e12
_STILL = 1e-6
"""A step that moves no unknown by more than this share of its standard deviation (all others held) is the last."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """The end of a search.

    Args:
        cost: sum of the loss of all residuals in standard deviations.
        converged: whether the last step was negligible.
    """

    state: State
    cost: float
    steps: int
    converged: bool


def weights(squares: Array, loss: str, scale: float) -> Array:
    """Weights of residuals whose squared length in standard deviations is given (n,): derivative of the loss."""
    if loss == "huber":
        return np.asarray(scale / np.maximum(np.sqrt(squares), scale))
    return np.asarray(1 / (1 + squares / scale**2)) if loss == "cauchy" else np.ones_like(squares)


def losses(squares: Array, loss: str, scale: float) -> Array:
    """The loss whose derivative by the square is :func:`weights`; for small residuals the square itself."""
    if loss == "huber":
        size = np.sqrt(squares)
        return np.where(size <= scale, squares, 2 * scale * size - scale**2)
    return np.asarray(scale**2 * np.log1p(squares / scale**2)) if loss == "cauchy" else squares


def residuals(state: State, data: Observations, offsets: Array) -> Array:
    """Measured minus predicted, (n, 2) px; ``offsets`` (n, 2) is centroid minus image of the centre."""
    return np.asarray(data.pixels - project(state, data.device, data.view, data.mark) - offsets)


def cost_of(state: State, data: Observations, offsets: Array, free: Parameterisation, loss: str, scale: float) -> float:
    """The sum that is minimised; infinite where a mark lies behind a device."""
    squares = (residuals(state, data, offsets) ** 2).sum(axis=1) / data.sigma**2
    if not np.isfinite(squares).all():
        return float("inf")
    cost = float(losses(squares, loss, scale).sum())
    if free.points:
        away = (state.points - free.nominal).ravel()
        cost += float((away**2).sum()) / (LOOSE * free.pitch_mm) ** 2
        cost += GAUGE_WEIGHT * float(((free.gauge() @ away) ** 2).sum())
    return cost


def normal_equations(
    state: State, data: Observations, offsets: Array, free: Parameterisation, loss: str, scale: float
) -> tuple[Array, Array, dict[tuple[int, int], Array]]:
    """Matrix (p, p) and right side (p,) for the free unknowns, and each image's own (22, 22) part.

    The unknowns are the columns of ``free.basis``, then the views, then the marks if they move.
    """
    slopes = project_with_slopes(state, data.device, data.view, data.mark)
    misfit = data.pixels - slopes.pixels - offsets
    weight = weights((misfit**2).sum(axis=1) / data.sigma**2, loss, scale) / data.sigma**2
    d, v = PER_DEVICE * state.devices, PER_VIEW * state.views
    n = 3 * len(state.points) if free.points else 0
    matrix, right = np.zeros((d + v + n, d + v + n)), np.zeros(d + v + n)
    blocks = {}
    both = np.concatenate([slopes.of_device, slopes.of_view], axis=-1)
    of_device, of_view = np.arange(PER_DEVICE), np.arange(PER_VIEW)
    for device, view, where in data.groups():
        local, w = both[where], weight[where]
        index = np.concatenate([PER_DEVICE * device + of_device, d + PER_VIEW * view + of_view])
        flat = (local * w[:, None, None]).reshape(-1, local.shape[-1])
        block = flat.T @ local.reshape(-1, local.shape[-1])
        blocks[device, view] = block
        matrix[np.ix_(index, index)] += block
        right[index] += flat.T @ misfit[where].ravel()
        if n:
            _add_points(matrix, right, d + v, index, data.mark[where], slopes.of_point[where], local, misfit[where], w)
    if n:
        away, gauge = (state.points - free.nominal).ravel(), free.gauge()
        prior = np.eye(n) / (LOOSE * free.pitch_mm) ** 2 + GAUGE_WEIGHT * gauge.T @ gauge
        matrix[d + v :, d + v :] += prior
        right[d + v :] -= prior @ away
    return *_reduced(matrix, right, free.basis), blocks


def _add_points(
    matrix: Array, right: Array, start: int, index: NDArray[np.int64], mark: NDArray[np.int64], of_point: Array,
    local: Array, misfit: Array, weight: Array
) -> None:  # fmt: skip
    weighted = of_point * weight[:, None, None]
    places = start + 3 * mark[:, None] + np.arange(3)  # (n, 3); no mark is twice in an image
    cross = np.einsum("nia,nib->anb", local, weighted).reshape(len(index), -1)
    matrix[places[:, :, None], places[:, None, :]] += np.einsum("nia,nib->nab", of_point, weighted)
    matrix[np.ix_(index, places.ravel())] += cross
    matrix[np.ix_(places.ravel(), index)] += cross.T
    right[places] += np.einsum("nia,ni->na", weighted, misfit)


def _reduced(matrix: Array, right: Array, basis: Array) -> tuple[Array, Array]:
    """The equations for the independent directions of the devices."""
    d = len(basis)
    upper = np.concatenate([basis.T @ matrix[:d, :d] @ basis, basis.T @ matrix[:d, d:]], axis=1)
    lower = np.concatenate([matrix[d:, :d] @ basis, matrix[d:, d:]], axis=1)
    return np.concatenate([upper, lower]), np.concatenate([basis.T @ right[:d], right[d:]])


def fit(
    state: State,
    data: Observations,
    offsets: Array,
    free: Parameterisation,
    *,
    loss: str = "huber",
    scale: float = 3.0,
    most_steps: int = MOST_STEPS,
) -> Fit:
    """Minimise the loss from a start.

    Marquardt's damping in units of the diagonal; a step is taken only if it lowers the cost.
    """
    cost = cost_of(state, data, offsets, free, loss, scale)
    if not np.isfinite(cost):
        return Fit(state, cost, 0, False)
    damping, steps = _FIRST_DAMPING, 0
    while steps < most_steps:
        matrix, right, _ = normal_equations(state, data, offsets, free, loss, scale)
        size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
        scaled, gradient = matrix / np.outer(size, size), right / size
        while True:
            steps += 1
            step = _solved(scaled, gradient, damping)
            small = float(np.abs(step).max(initial=0.0)) < _STILL
            tried = state.stepped(_full(step / size, free.basis))
            new = cost_of(tried, data, offsets, free, loss, scale)
            if new <= cost:
                break
            if small or damping > _MOST_DAMPING:
                return Fit(state, cost, steps, small)
            damping *= 5
        small = small or cost - new < 1e-12 * cost
        state, cost = tried, new
        damping = max(damping / 8, 1e-14)
        if small:
            return Fit(state, cost, steps, True)
    return Fit(state, cost, steps, False)


def _full(step: Array, basis: Array) -> Array:
    """A step of all unknowns from one of the independent directions."""
    k = basis.shape[1]
    return np.concatenate([basis @ step[:k], step[k:]])


def _solved(matrix: Array, right: Array, damping: float) -> Array:
    """The damped step; more damping where the matrix is singular to rounding."""
    while True:
        damped = matrix.copy()
        damped.flat[:: len(matrix) + 1] += damping
        try:
            factor = np.linalg.cholesky(damped)
        except np.linalg.LinAlgError:
            damping *= 10
            continue
        return np.asarray(np.linalg.solve(factor.T, np.linalg.solve(factor, right)))
