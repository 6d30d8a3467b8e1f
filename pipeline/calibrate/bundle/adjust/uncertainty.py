"""Uncertainty of the result: covariance, noise per device, derived figures."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.levenberg_marquardt import normal_equations, residuals
from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.adjust.parameterisation import Parameterisation, names_of
from pipeline.calibrate.bundle.adjust.state import PER_DEVICE, PER_VIEW, State, cross_matrices
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]

_WORST_CONDITION = 1e-15


def inverse(matrix: Array) -> Array:
    """Inverse of a positive definite matrix, scaled to a unit diagonal first.

    Raises:
        CalibrationError: some combination of unknowns is not determined.
    """
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    if values[0] < _WORST_CONDITION * values[-1]:
        raise CalibrationError(
            "the views do not determine all parameters; show the board at more positions, tilted by 20 to 40 degrees "
            "about both axes"
        )
    return np.asarray((vectors / values) @ vectors.T / np.outer(size, size))


def full_covariance(state: State, data: Observations, offsets: Array, free: Parameterisation) -> tuple[Array, Array]:
    """Covariance of all unknowns (devices, views, marks), and the redundancy of each device, (d,).

    The redundancy is the number of a device's coordinates that determine its noise (Foerstner, 1979): two a mark minus
    the trace of its image's part of the normal matrix times the covariance.
    """
    matrix, _, blocks = normal_equations(state, data, offsets, free, "squared", 1.0)
    reduced = inverse(matrix)
    d, k = free.basis.shape
    spread = np.zeros((d + len(reduced) - k, len(reduced)))
    spread[:d, :k] = free.basis
    spread[d:, k:] = np.eye(len(reduced) - k)
    covariance = spread @ reduced @ spread.T
    redundancy = np.array([2.0 * (data.device == device).sum() for device in range(state.devices)])
    if free.points:
        # The marks' own unknowns belong to all devices: the share is taken from each alike.
        return covariance, redundancy * max(1 - (len(reduced) - len(free.gauge())) / (2 * len(data)), 1e-3)
    for (device, view), block in blocks.items():
        index = np.r_[PER_DEVICE * device : PER_DEVICE * (device + 1), d + PER_VIEW * view : d + PER_VIEW * (view + 1)]
        redundancy[device] -= float((block * covariance[np.ix_(index, index)]).sum())
    return covariance, redundancy


def noise_floor(squares: Array, sigma: Array, redundancy: float) -> tuple[float, float]:
    """(floor_px, factor) by which the standard deviations agree with the residuals.

    The variance of a mark's coordinate is ``(factor sigma)^2 + floor^2``: more noise than expected is the same for all
    marks (detector bias, a board that is not flat, a lens beyond the model), less scales the expected one.

    Args:
        squares: (n,) squared length of the residuals, px^2.
        sigma: (n,) expected standard deviation of a coordinate, px.
        redundancy: of these residuals' 2 n coordinates.
    """
    expected = max(redundancy, 1.0)
    ratio = float((squares / sigma**2).sum() / expected)
    if ratio <= 1:
        return 0.0, float(np.sqrt(ratio))
    low, high = 0.0, float(squares.sum() / expected)
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if (squares / (sigma**2 + middle)).sum() > expected else (low, middle)
    return float(np.sqrt(high)), 1.0


def derived(
    state: State, devices: Sequence[str], covariance: Array
) -> tuple[dict[str, float], dict[str, float], Array]:
    """Values and standard deviations of the devices' parameters, baselines and angles, and the parameters' covariance.

    Rotations are given as rotation vectors, to which the covariance of small rotations is propagated.

    Args:
        state: the solution.
        devices: their names.
        covariance: of the devices' unknowns.
    """
    names = names_of(devices)
    values: dict[str, float] = {}
    carry = np.eye(len(names))
    for number in range(len(devices)):
        at = PER_DEVICE * number
        vector = rotation_vector(state.rotations[number])
        carry[at + 10 : at + 13, at + 10 : at + 13] = left_jacobian_inverse(vector)
        numbers = [*state.intrinsics[number], *vector, *state.translations[number]]
        values |= dict(zip(names[at : at + PER_DEVICE], map(float, numbers), strict=True))
    carried = carry @ covariance @ carry.T
    sigma = {name: float(np.sqrt(max(carried[k, k], 0.0))) for k, name in enumerate(names)}
    for number, device in enumerate(devices[1:], start=1):
        prefix = "" if device == "right" else f"{device}."
        at = PER_DEVICE * number
        t, r = state.translations[number], state.rotations[number]
        length = float(np.linalg.norm(t))
        by = t / max(length, 1e-300)
        values[f"{prefix}baseline_mm"] = length
        sigma[f"{prefix}baseline_mm"] = float(np.sqrt(by @ covariance[at + 13 : at + 16, at + 13 : at + 16] @ by))
        sine = max(float(np.hypot(r[0, 2], r[1, 2])), 1e-12)
        by = np.array([-r[1, 2], r[0, 2], 0.0]) / sine
        values[f"{prefix}angle_deg"] = float(np.degrees(np.arctan2(sine, r[2, 2])))
        spread = float(np.sqrt(by @ covariance[at + 10 : at + 13, at + 10 : at + 13] @ by))
        sigma[f"{prefix}angle_deg"] = float(np.degrees(spread))
    return values, sigma, carried


def left_jacobian_inverse(vector: Array) -> Array:
    """Derivative (3, 3) of the rotation vector by a small left rotation (inverse of SO(3)'s left Jacobian)."""
    angle = float(np.linalg.norm(vector))
    cross = cross_matrices(vector[None])[0]
    factor = 1 / 12 if angle < 1e-4 else 1 / angle**2 - (1 + np.cos(angle)) / (2 * angle * np.sin(angle))
    return np.asarray(np.eye(3) - cross / 2 + factor * cross @ cross)


def rotation_vector(rotation: Array) -> Array:
    """Axis times angle, (3,) radians, of a rotation matrix."""
    axis = np.array([rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]])
    angle = float(np.arctan2(np.linalg.norm(axis), np.trace(rotation) - 1))
    if angle < 1e-7:
        return axis / 2
    if np.pi - angle < 1e-4:
        values, vectors = np.linalg.eigh((rotation + rotation.T) / 2)
        return np.asarray(vectors[:, int(values.argmax())] * angle)
    return np.asarray(axis / (2 * np.sin(angle)) * angle)


def noise_of(
    state: State, data: Observations, offsets: Array, expected_sigma: Array, redundancy: Array
) -> dict[int, tuple[float, float]]:
    """(floor_px, factor) by device, see :func:`noise_floor`, for marks with expected standard deviations (n,)."""
    squares = (residuals(state, data, offsets) ** 2).sum(axis=1)
    by = {device: data.device == device for device in range(state.devices)}
    return {
        device: noise_floor(squares[chosen], expected_sigma[chosen], float(redundancy[device]))
        for device, chosen in by.items()
        if chosen.any()
    }
