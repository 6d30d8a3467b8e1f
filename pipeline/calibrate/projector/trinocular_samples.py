"""Points and the projector coordinates observed there, for the trinocular residual.

Two sources: a cloud of the single-shot measurement with the phases of its left image, and the absolute phases of a
scene at rest in both cameras. In the second the cameras' pixels are matched by both projector coordinates, so that the
projector's geometry is not used.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.projector.absolute_phase import Coordinate
from pipeline.calibrate.projector.trinocular_residual import Samples
from pipeline.common.errors import CalibrationError
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.decode.decoder import PhaseMap
from pipeline.geometry.triangulate import triangulate
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

F64: TypeAlias = NDArray[np.float64]
Ints: TypeAlias = NDArray[np.int64]

_TURN = 2 * np.pi
_NEAR = 2
_RADIUS = 2
_FEWEST_NEIGHBOURS = 16
_FARTHEST_PX = 2.5
_ROUGHEST_PX = 0.3


def samples_of_cloud(cloud: Cloud, phases: PhaseMap, pattern: ColorFringe, *, stride: int = 6) -> Samples:
    """Of a single-shot measurement.

    The normalised phase is used: on coloured surfaces the error of the pointwise phase is equal in both cameras, so
    that it affects no match, but this residual.

    Args:
        cloud: of the pair; phases: of its left image, before the decoder has another one.
        stride: step of the pixels taken, in both directions; beyond the decoder's window they err independently.
    """
    part = np.s_[stride // 2 :: stride, stride // 2 :: stride]
    order, points = cloud.order[part].astype(np.float64), cloud.xyz[part].astype(np.float64)
    wrapped, normalised = phases.phase[part].astype(np.float64), phases.phase_normalised[part].astype(np.float64)
    valid = np.isfinite(points[..., 2]) & (cloud.order[part] >= 0)
    absolute = wrapped + _TURN * order
    absolute += np.angle(np.exp(1j * (normalised - wrapped)))
    column = pattern.column_of(absolute)
    sigma = np.sqrt(phases.variance[part].astype(np.float64)) * pattern.length / (_TURN * pattern.periods)
    valid &= np.isfinite(column) & (sigma > 0)
    axis = np.full(int(valid.sum()), 0 if pattern.axis == "x" else 1)
    return Samples(points[valid], column[valid], axis, sigma[valid])


class PairSampler:
    """Samples of single-shot pairs of scenes at rest: built once for a rig, then called for every pair.

    Args:
        calibration: of the rig; pattern: what the projector shows; volume: where surfaces may be.
        encoding: of the raw images.
        settings: of the reconstruction.
        stride: see :func:`samples_of_cloud`.
    """

    def __init__(
        self,
        calibration: Calibration,
        pattern: ColorFringe,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        stride: int = 6,
    ) -> None:
        self._reconstructor = Reconstructor(calibration, pattern, volume, encoding=encoding, settings=settings)
        self._stride = stride

    def __call__(self, left: NDArray[np.uint8], right: NDArray[np.uint8]) -> Samples:
        """Samples of a pair of raw images, as :class:`pipeline.reconstruct.reconstructor.Reconstructor` takes them."""
        made, watch = self._reconstructor, Stopwatch(None)
        decided = made.orders(left, right, watch)
        cloud = made.stage(1).cloud(*decided, made.correction, watch)
        return samples_of_cloud(cloud, decided[0], made.pattern, stride=self._stride)


def samples_of_phases(
    calibration: Calibration,
    left: tuple[Coordinate, Coordinate],
    right: tuple[Coordinate, Coordinate],
    *,
    stride: int = 6,
) -> Samples:
    """Of a scene at rest under a sequence: projector columns and rows (x, y) of both cameras' pixels.

    Planes are fitted in 5 x 5 pixels: in the left image for the projector coordinates, in the right one for the
    position of the same coordinates.

    Args:
        stride: step of the left pixels taken, in both directions.
    """
    left_field = _stacked(left)
    right_field = _stacked(right)
    for name, field, device in (("left", left_field, calibration.left), ("right", right_field, calibration.right)):
        if field.shape[:2] != device.size[::-1]:
            raise CalibrationError(f"{name} phases are {field.shape[:2]}, the camera's image is {device.size[::-1]}")
    rows, columns = left_field.shape[:2]
    v, u = (index.ravel() for index in np.mgrid[stride // 2 : rows : stride, stride // 2 : columns : stride])
    lit_by, _, valid = _fits(left_field, u, v)
    u, v, lit_by = u[valid], v[valid], lit_by[valid]
    matched_u, matched_v, valid = _lookup(right_field, lit_by, calibration.projector.size)
    u, v, lit_by, matched_u, matched_v = u[valid], v[valid], lit_by[valid], matched_u[valid], matched_v[valid]
    value, gradient, valid = _fits(right_field, matched_u, matched_v)
    # Solved pixel by pixel where both coordinates change with the position.
    valid &= np.abs(np.linalg.det(gradient)) > 1e-3
    u, v, lit_by, matched_u, matched_v = u[valid], v[valid], lit_by[valid], matched_u[valid], matched_v[valid]
    away = np.linalg.solve(gradient[valid], (lit_by - value[valid])[..., None])[..., 0]
    match = np.stack([matched_u, matched_v], axis=1) + away
    valid = (np.abs(away) <= _FARTHEST_PX).all(axis=1)
    pixels, lit_by = np.stack([u, v], axis=1)[valid].astype(np.float64), lit_by[valid]
    points = triangulate(calibration.left, calibration.right, pixels, match[valid])
    noise = [
        np.hypot(one.sigma_px[v, u], other.sigma_px[matched_v, matched_u])[valid] / (2 * _RADIUS + 1)
        for one, other in zip(left, right, strict=True)
    ]
    axis = np.repeat(np.arange(2), len(points))
    return Samples(np.concatenate([points, points]), lit_by.T.ravel(), axis, np.concatenate(noise))


def _stacked(pair: tuple[Coordinate, Coordinate]) -> F64:
    """(H, W, 2), both valid or both NaN."""
    both = np.stack([pair[0].px, pair[1].px], axis=-1)
    both[~np.isfinite(both).all(axis=-1)] = np.nan
    return both


def _fits(field: F64, u: Ints, v: Ints) -> tuple[F64, F64, NDArray[np.bool_]]:
    """Planes through 5 x 5 values around pixels: value (n, 2), slope (n, 2, 2) by (u, v), and whether it is smooth."""
    rows, columns = field.shape[:2]
    dv, du = (index.ravel() for index in np.mgrid[-_RADIUS : _RADIUS + 1, -_RADIUS : _RADIUS + 1])
    inside = (u >= _RADIUS) & (v >= _RADIUS) & (u < columns - _RADIUS) & (v < rows - _RADIUS)
    at_v, at_u = np.where(inside, v, _RADIUS)[:, None] + dv, np.where(inside, u, _RADIUS)[:, None] + du
    values = field[at_v, at_u]
    valid = np.isfinite(values[..., 0])
    enough = inside & (valid.sum(axis=1) >= _FEWEST_NEIGHBOURS)
    design = np.stack([np.ones(len(du)), du, dv], axis=1).astype(np.float64)
    normal = np.einsum("nk,ki,kj->nij", valid.astype(np.float64), design, design)
    normal[~enough] = np.eye(3)
    right = np.einsum("ki,nkc->nic", design, np.where(valid[..., None], values, 0.0))
    solution = np.linalg.solve(normal, right)
    rest = np.where(valid[..., None], values - np.einsum("ki,nic->nkc", design, solution), 0.0)
    rough = np.sqrt((rest**2).sum(axis=1) / np.maximum(valid.sum(axis=1), 4)[:, None] * 25 / 22).max(axis=1)
    return solution[:, 0], np.swapaxes(solution[:, 1:], 1, 2), enough & (rough <= _ROUGHEST_PX)


def _lookup(field: F64, targets: F64, size: tuple[int, int]) -> tuple[Ints, Ints, NDArray[np.bool_]]:
    """Pixels (u, v) with the projector coordinates nearest to the targets (n, 2), and whether there is one near."""
    width, height = size
    v, u = np.nonzero(np.isfinite(field[..., 0]))
    cell = np.rint(field[v, u]).astype(np.int64)
    table = np.full((height + 2 * _NEAR, width + 2 * _NEAR), -1, np.int64)
    table[np.clip(cell[:, 1], 0, height - 1) + _NEAR, np.clip(cell[:, 0], 0, width - 1) + _NEAR] = np.arange(len(u))
    cells = np.clip(np.rint(targets).astype(np.int64), 0, [width - 1, height - 1]) + _NEAR
    best, least = np.zeros(len(targets), np.int64), np.full(len(targets), np.inf)
    for dy in range(-_NEAR, _NEAR + 1):
        for dx in range(-_NEAR, _NEAR + 1):
            found = table[cells[:, 1] + dy, cells[:, 0] + dx]
            index = np.where(found >= 0, found, 0)
            away = np.hypot(*(field[v[index], u[index]] - targets).T) if len(u) else least
            closer = (found >= 0) & (away < least)
            best[closer], least[closer] = found[closer], away[closer]
    fine = np.isfinite(least)
    return (u[best], v[best], fine) if len(u) else (best, best, fine)
