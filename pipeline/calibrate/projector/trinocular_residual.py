"""The dense trinocular residual, projector against the points of the cameras, and the correction of the projector.

Two calibrated cameras measure a surface without the projector's geometry: its phase only matches their pixels. Then
every point predicts the projector pixel that lights it, and the phase observed there gives the true one. The
difference over thousands of points of any scene at rest reveals a projector that has moved, rotated or refocused, and
corrects it. The cameras are the metric reference and stay unchanged.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel

F64: TypeAlias = NDArray[np.float64]

FEWEST_SAMPLES = 300
LARGEST_RESIDUAL_PX = 8.0
"""Median above which the points' fringe orders are unreliable and nothing is refined."""
_FEWEST_CELLS = 16
_CELLS = 12
_FEWEST_IN_CELL = 8
_ROUNDS = 12
_TEST_EVERY = 4
_SUPPORTED = 0.5
_NOTICED_PX = 0.02
_SIGNIFICANT = 3.0

DEFAULT_PRIOR: Mapping[str, float] = MappingProxyType(
    {
        "rotation_x": 1e-3, "rotation_y": 1e-3, "rotation_z": 1e-3, "x_mm": 0.5, "y_mm": 0.5, "z_mm": 0.5,
        "focal": 1e-3, "aspect": 1e-4, "cx": 2.0, "cy": 2.0,
    }
)  # fmt: skip
"""Prior of the changes (one standard deviation): rotations about the projector's own axes (radians), its
centre in the world, both focal lengths together and fy against fx (shares), principal point (pixels)."""
LENS_PRIOR: Mapping[str, float] = MappingProxyType({"k1": 0.02, "k2": 0.05, "p1": 5e-4, "p2": 5e-4})
"""Distortion, which a mechanical disturbance does not change: add it only where the lens was not calibrated well."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Points measured by the cameras, each with one projector coordinate that was observed there.

    Args:
        points: (n, 3) mm, world.
        observed: (n,) projector column or row; axis: (n,) 0 for a column, 1 for a row.
        sigma_px: (n,) expected standard deviation of ``observed``; only their ratios matter.
    """

    points: F64
    observed: F64
    axis: NDArray[np.int64]
    sigma_px: F64

    def __post_init__(self) -> None:
        n = len(self.observed)
        if self.points.shape != (n, 3) or self.axis.shape != (n,) or self.sigma_px.shape != (n,):
            raise CalibrationError(
                f"samples: points {self.points.shape}, observed {self.observed.shape}, axis {self.axis.shape} and "
                f"sigma_px {self.sigma_px.shape} do not agree"
            )

    def __len__(self) -> int:
        return len(self.observed)

    def some(self, chosen: NDArray[np.bool_]) -> Samples:
        """Those where ``chosen`` (n,) is true."""
        return Samples(self.points[chosen], self.observed[chosen], self.axis[chosen], self.sigma_px[chosen])


def joined(*parts: Samples) -> Samples:
    """All samples of several scenes."""
    names = ("points", "observed", "axis", "sigma_px")
    return Samples(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def residuals(projector: CameraModel, samples: Samples) -> F64:
    """Observed minus predicted projector coordinate, (n,) pixels."""
    predicted = projector.project(samples.points)
    return np.asarray(samples.observed - np.where(samples.axis == 0, predicted[:, 0], predicted[:, 1]))


@dataclass(frozen=True, slots=True)
class Spread:
    """Statistics of the residuals of many samples, pixels.

    Args:
        rms_px: robust, noise and all.
        systematic_px: root mean square over cells of the projector's image of the cell's median, the median's own
            noise removed: the part that a better projector model removes.
        worst_px: largest median of a cell.
        samples: number of them; wrong: share that lies beyond 5 robust deviations.
    """

    rms_px: float
    systematic_px: float
    worst_px: float
    samples: int
    wrong: float


def spread(projector: CameraModel, samples: Samples) -> Spread:
    """Statistics of a projector's residuals."""
    error = residuals(projector, samples)
    usual = 1.4826 * float(np.median(np.abs(error - np.median(error)))) + 1e-9
    fine = np.abs(error - np.median(error)) <= 5 * usual
    medians, noise = _cells(projector, samples.some(fine), error[fine])
    systematic = float(np.sqrt(max(float((medians**2 - noise**2).mean()), 0.0))) if len(medians) else 0.0
    worst = float(np.abs(medians).max(initial=0.0))
    return Spread(float(np.sqrt((error[fine] ** 2).mean())), systematic, worst, len(samples), 1 - float(np.mean(fine)))


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A corrected projector with its uncertainty.

    Args:
        calibration: the given one with the projector corrected.
        before, after: residuals of samples that were not used for the correction.
        changes: by how much each parameter was changed; units as in :data:`DEFAULT_PRIOR`.
        sigma: standard deviation of each change, the prior included; correlated ones (a rotation and a shift of
            the principal point) are each uncertain but accurate together: see the covariance, in the same order.
        effect_px: root mean square of what each change does to the observed coordinates.
        prior: standard deviation of each parameter before the fit.
    """

    calibration: Calibration
    before: Spread
    after: Spread
    changes: dict[str, float]
    sigma: dict[str, float]
    effect_px: dict[str, float]
    prior: dict[str, float]
    covariance: F64

    @property
    def before_px(self) -> float:
        """Root mean square residual before."""
        return self.before.rms_px

    @property
    def after_px(self) -> float:
        """Root mean square residual after."""
        return self.after.rms_px

    @property
    def changed(self) -> tuple[str, ...]:
        """Parameters whose change moves what the projector shows by more than 0.02 px."""
        return tuple(name for name, effect in self.effect_px.items() if effect > _NOTICED_PX)

    @property
    def supported(self) -> tuple[str, ...]:
        """Parameters whose standard deviation the samples reduce at least to half of the prior."""
        return tuple(name for name, sigma in self.sigma.items() if sigma < _SUPPORTED * self.prior[name])

    @property
    def better(self) -> bool:
        """Whether held-out samples agree better with it."""
        return self.after.rms_px < self.before.rms_px


def refine_projector(
    calibration: Calibration, samples: Samples, *, prior: Mapping[str, float] = DEFAULT_PRIOR
) -> Refined:
    """The projector that agrees best with the samples, and departs least from the calibrated one.

    A maximum a posteriori fit by Gauss-Newton steps with Tukey's weights. What the samples do not determine stays
    unchanged: a parameter is held by its prior, and a combination of parameters (an eigenvector of the information) is
    only changed where the samples show it at 3 standard deviations. Every fourth sample is held out for evaluation.

    Args:
        prior: parameters that may change and their standard deviations; see :data:`DEFAULT_PRIOR`, :data:`LENS_PRIOR`.

    Raises:
        CalibrationError: too few samples, too small a part of the projector's image, or residuals so large that the
            points themselves are unreliable.
    """
    unknown = set(prior) - set(DEFAULT_PRIOR) - set(LENS_PRIOR)
    if unknown or not prior or not all(value > 0 for value in prior.values()):
        raise CalibrationError(f"prior of the projector: {sorted(unknown) or dict(prior)} has unknown or no parameters")
    usable = np.isfinite(samples.points).all(axis=1) & np.isfinite(samples.observed) & (samples.sigma_px > 0)
    samples = samples.some(usable)
    _check(calibration.projector, samples)
    test = np.arange(len(samples)) % _TEST_EVERY == _TEST_EVERY - 1
    used, held_out = samples.some(~test), samples.some(test)
    values, covariance = _solved(calibration.projector, used, prior)
    changes = dict(zip(prior, values.tolist(), strict=True))
    projector = moved(calibration.projector, changes)
    start = residuals(calibration.projector, held_out)
    effects = {
        name: float(np.sqrt(np.mean((residuals(moved(calibration.projector, {name: value}), held_out) - start) ** 2)))
        for name, value in changes.items()
    }
    return Refined(
        replace(calibration, projector=projector),
        spread(calibration.projector, held_out),
        spread(projector, held_out),
        changes,
        dict(zip(prior, np.sqrt(np.diag(covariance)).tolist(), strict=True)),
        effects,
        dict(prior),
        covariance,
    )


def moved(projector: CameraModel, changes: Mapping[str, float]) -> CameraModel:
    """The projector with some of its parameters changed; names and units as in :data:`DEFAULT_PRIOR`."""

    def of(name: str) -> float:
        return changes.get(name, 0.0)

    turn = rotation_of(np.array([of("rotation_x"), of("rotation_y"), of("rotation_z")]))
    rotation = turn @ projector.rotation
    centre = projector.centre + np.array([of("x_mm"), of("y_mm"), of("z_mm")])
    matrix = projector.matrix.copy()
    matrix[:2, :2] *= 1 + of("focal")
    matrix[1, 1] *= 1 + of("aspect")
    matrix[:2, 2] += of("cx"), of("cy")
    distortion = projector.distortion + np.array([of("k1"), of("k2"), of("p1"), of("p2"), 0.0])
    return CameraModel(projector.size, matrix, distortion, rotation, -rotation @ centre, projector.name)


def rotation_of(vector: F64) -> F64:
    """Rotation matrix of a rotation vector (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # sin(a) / a and (1 - cos(a)) / a^2, also for no angle at all.
    first, second = np.sinc(angle / np.pi), 0.5 * np.sinc(angle / (2 * np.pi)) ** 2
    return np.asarray(np.eye(3) + first * cross + second * (cross @ cross))


def _check(projector: CameraModel, samples: Samples) -> None:
    if len(samples) < FEWEST_SAMPLES:
        raise CalibrationError(
            f"{len(samples)} points with an observed projector coordinate, at least {FEWEST_SAMPLES} are needed; "
            "show a larger, brighter surface"
        )
    error = residuals(projector, samples)
    if not np.median(np.abs(error)) <= LARGEST_RESIDUAL_PX:
        raise CalibrationError(
            f"the projector is off by {np.median(np.abs(error)):.1f} px (median), limit {LARGEST_RESIDUAL_PX:g} px: "
            "the measurement itself is unreliable; calibrate again"
        )
    cells = len(_cells(projector, samples, error)[0])
    if cells < _FEWEST_CELLS:
        raise CalibrationError(
            f"the points lie in {cells} of {_CELLS * _CELLS} parts of the projector's image, at least "
            f"{_FEWEST_CELLS} are needed; show a larger surface"
        )


def _cells(projector: CameraModel, samples: Samples, error: F64) -> tuple[F64, F64]:
    """Median residual of each cell of the projector's image (of each axis apart), and its standard deviation."""
    where = np.floor(_CELLS * (projector.project(samples.points) + 0.5) / projector.size)
    cell = (np.clip(where, 0, _CELLS - 1) @ [_CELLS, 1]).astype(np.int64) + _CELLS**2 * samples.axis
    order = np.argsort(cell, kind="stable")
    parts = np.split(error[order], np.flatnonzero(np.diff(cell[order])) + 1)
    full = [part for part in parts if len(part) >= _FEWEST_IN_CELL]
    medians = np.array([np.median(part) for part in full])
    deviation = np.array([1.4826 * np.median(np.abs(part - np.median(part))) for part in full])
    return medians, 1.2533 * deviation / np.sqrt([len(part) for part in full])


def _solved(start: CameraModel, samples: Samples, prior: Mapping[str, float]) -> tuple[F64, F64]:
    """Changes and their covariance."""
    names, prior_sigma = list(prior), np.array(list(prior.values()))
    values = np.zeros(len(prior_sigma))

    def error_at(scaled: F64) -> F64:
        return residuals(moved(start, dict(zip(names, scaled * prior_sigma, strict=True))), samples) / samples.sigma_px

    for _ in range(_ROUNDS):
        error = error_at(values)
        spread_of = 1.4826 * float(np.median(np.abs(error - np.median(error)))) + 1e-12
        # The first rounds bring the residuals to 0; until then their median does not count as an outlier.
        reach = 4.685 * spread_of + np.abs(np.median(error))
        weight = np.maximum(1 - (error / reach) ** 2, 0) ** 2 / spread_of**2
        slopes = _slopes(error_at, values)
        normal = slopes.T @ (slopes * weight[:, None]) + np.eye(len(values))
        step = np.linalg.solve(normal, -slopes.T @ (weight * error) - values)
        values = values + step
        if np.abs(step).max() < 1e-7:
            break
    final = moved(start, dict(zip(names, values * prior_sigma, strict=True)))
    medians, noise = _cells(final, samples, residuals(final, samples))
    # Correlated errors of neighbours carry less information: the scatter of the cells measures how much less.
    excess = float((medians**2).sum() / max(float((noise**2).sum()), 1e-18)) if len(medians) > len(values) else 1.0
    information, mixtures = np.linalg.eigh((normal - np.eye(len(values))) / max(excess, 1.0))
    information = np.maximum(information, 1e-12)
    shares = mixtures.T @ values
    # Without its prior a share would be (information + 1) / information as large, with a standard deviation of 1 /
    # sqrt(information).
    shares[np.abs(shares) * (information + 1) / np.sqrt(information) < _SIGNIFICANT] = 0.0
    covariance = (mixtures / (information + 1)) @ mixtures.T
    return (mixtures @ shares) * prior_sigma, np.asarray(covariance * np.outer(prior_sigma, prior_sigma))


def _slopes(function: Callable[[F64], F64], at: F64, step: float = 1e-4) -> F64:
    """Jacobian by central differences, (n, p)."""
    moves = step * np.eye(len(at))
    return np.stack([(function(at + d) - function(at - d)) / (2 * step) for d in moves], axis=1)
