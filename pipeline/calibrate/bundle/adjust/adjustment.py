"""The outer iteration of the adjustment: least squares, circle offsets, noise of each device, outliers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust import circle_offsets
from pipeline.calibrate.bundle.adjust.levenberg_marquardt import MOST_STEPS, Fit, fit, residuals
from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.parameterisation import Parameterisation
from pipeline.calibrate.bundle.adjust.state import State
from pipeline.calibrate.bundle.adjust.uncertainty import full_covariance, noise_of
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]

_ROUNDS = 12
_STILL_PX = 2e-6
_EXACT_PX = 1e-5
"""Lower bound of the standard deviations: only synthetic marks agree better, and smaller values are ill-conditioned."""


@dataclass(frozen=True, slots=True, eq=False)
class Adjusted:
    """The result of :func:`adjust`.

    Args:
        fit: of the last search.
        data: the marks that were used, with the standard deviations found.
        expected_sigma: (n,) the standard deviations given with the marks.
        out: the rejected marks.
        out_by: (m,) their residuals in standard deviations.
        offsets: (n, 2) circle offsets, px.
        diameter_mm: of the circles; 0 = points.
        covariance: of all unknowns.
        noise: by device (floor_px, factor), see :func:`pipeline.calibrate.bundle.adjust.uncertainty.noise_floor`.
    """

    fit: Fit
    data: Observations
    expected_sigma: Array
    out: Observations
    out_by: Array
    offsets: Array
    diameter_mm: float
    covariance: Array
    noise: dict[int, tuple[float, float]]

    @property
    def state(self) -> State:
        """All values."""
        return self.fit.state


def to_scale(adjusted: Adjusted, options: Options) -> Adjusted:
    """The same result, scaled to the given distance between two marks of the board.

    Raises:
        CalibrationError: a mark of ``options.known_distance`` is not on the board.
    """
    if options.known_distance is None:
        return adjusted
    first, second, length = options.known_distance
    state = adjusted.state
    if first == second or not all(0 <= mark < len(state.points) for mark in (first, second)):
        raise CalibrationError(
            f"known_distance names marks {first} and {second}: expected two different marks from 0 to "
            f"{len(state.points) - 1}"
        )
    factor = length / float(np.linalg.norm(state.points[first] - state.points[second]))
    # Translations of devices and views, and the marks, are lengths.
    of_device, of_view = np.repeat([1.0, factor], [13, 3]), np.repeat([1.0, factor], [3, 3])
    scale = np.concatenate([np.tile(of_device, state.devices), np.tile(of_view, state.views)])
    scale = np.concatenate([scale, np.full(len(adjusted.covariance) - len(scale), factor)])
    return replace(
        adjusted,
        fit=replace(adjusted.fit, state=state.scaled(factor)),
        diameter_mm=adjusted.diameter_mm * factor,
        covariance=adjusted.covariance * np.outer(scale, scale),
    )


def first_sigma(state: State, data: Observations, offsets: Array) -> Array:
    """Standard deviations (n,) from the median residual of each device, which is robust against outliers."""
    distance = np.linalg.norm(residuals(state, data, offsets), axis=1)
    sigma = data.sigma.copy()
    for device in range(state.devices):
        chosen = data.device == device
        if chosen.any():
            # The median of the length of a normal pair is 1.1774 standard deviations.
            scale = float(np.median(distance[chosen])) / 1.1774
            sigma[chosen] = np.maximum(scale * sigma[chosen] / np.median(sigma[chosen]), _EXACT_PX)
    return sigma


def adjust(
    state: State,
    data: Observations,
    free: Parameterisation,
    options: Options,
    board: Board,
    *,
    diameter_mm: float = 0.0,
) -> Adjusted:
    """Repeat the least squares until circle offsets, noise and the choice of marks converge.

    Args:
        state: start near the solution.
        data: all marks of the views that are used, with their expected standard deviations.
        free: the unknowns that are adjusted.
        options: loss and limits.
        board: for the circles' diameter, where it is given.
        diameter_mm: first value, else the board's or from the areas.

    Raises:
        CalibrationError: the views do not determine all unknowns.
    """
    kept, expected_sigma = np.ones(len(data), dtype=bool), data.sigma
    nominal = board.diameter_mm if board.round else 0.0
    diameter = nominal or diameter_mm or circle_offsets.diameter_mm(state, data)
    shift = circle_offsets.offsets(state, data, diameter)
    sigma = first_sigma(state, data, shift)
    for iteration in range(_ROUNDS):
        used = data.with_sigma(sigma).some(kept)
        loss = "cauchy" if iteration == 0 and options.loss != "squared" else options.loss
        fitted = fit(state, used, shift[kept], free, loss=loss, scale=options.loss_scale)
        state = fitted.state
        diameter = nominal or circle_offsets.diameter_mm(state, data.some(kept))
        new = circle_offsets.offsets(state, data, diameter)
        moved = float(np.abs(new - shift).max(initial=0.0))
        shift = new
        if iteration == 0:
            sigma = first_sigma(state, data, shift)
        else:
            covariance, redundancy = full_covariance(state, used, shift[kept], free)
            noise = noise_of(state, data.some(kept), shift[kept], expected_sigma[kept], redundancy)
            before = sigma
            sigma = _sigmas(expected_sigma, data, noise)
            deviation = np.linalg.norm(residuals(state, data, shift), axis=1) / sigma
            converged = np.abs(np.log(sigma / before)).max() < 1e-3 and moved < _STILL_PX
            result = Adjusted(
                fitted, used, expected_sigma[kept], data.with_sigma(sigma).some(~kept), deviation[~kept], shift[kept],
                diameter, covariance, noise,
            )  # fmt: skip
            within = ~(deviation > options.mark_limit) if options.loss != "squared" else kept
            if converged and (within == kept).all():
                break
            kept = within if iteration < _ROUNDS - 3 else kept & within
    if not result.fit.converged and result.fit.steps >= MOST_STEPS:
        raise CalibrationError(
            f"the search did not settle within {MOST_STEPS} steps: the views contradict each other or determine too "
            "little; hold k3 and the tangential terms, or add views"
        )
    return result


def _sigmas(expected_sigma: Array, data: Observations, noise: dict[int, tuple[float, float]]) -> Array:
    sigma = expected_sigma.copy()
    for device, (floor, factor) in noise.items():
        chosen = data.device == device
        sigma[chosen] = np.maximum(np.hypot(factor * expected_sigma[chosen], floor), _EXACT_PX)
    return sigma
