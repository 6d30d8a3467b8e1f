"""Wrong points, false surfaces and error against sigma, by the distance to a depth edge, against the truth."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from sim.evaluate.score import RIGHT_MM, WRONG_MM
from sim.render.ground_truth import Truth

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]

SURFACE_STEP_MM = 3.0
"""Neighbours of one surface differ by less in depth."""
SURFACE_PIXELS = 30
"""The smallest false surface that counts."""
RINGS: tuple[tuple[str, float, float], ...] = (
    ("edge", 0.0, 1.5),
    ("2-3", 1.5, 3.5),
    ("4-6", 3.5, 6.5),
    ("inside", 6.5, np.inf),
)
"""Name and distances in pixels to the nearest edge: at least, less than."""


@dataclass(frozen=True, slots=True)
class Ring:
    """Figures of the pixels at one range of distances to an edge.

    Args:
        covered: share of the measurable pixels with a point that errs by less than 1 mm.
        wrong: share of the points that err by more than 6 mm.
        error_to_sigma: root mean square of error / sigma along the ray, of the points that are not wrong.
    """

    covered: float
    wrong: float
    error_to_sigma: float


@dataclass(frozen=True, slots=True)
class PointErrors:
    """Figures of one cloud.

    Args:
        covered: share of the measurable pixels (lit, seen by both cameras, inside the volume) within 1 mm.
        wrong: share of the points that err by more than 6 mm or have no truth.
        wrong_alone: share of the points that are wrong against the truth of all eight neighbours, too.
        false_surfaces: number of connected surfaces of at least 30 points of which half or more are wrong.
        false_points: points of these.
        rms_mm: root mean square error of the points that err by less than 1 mm.
        error_to_sigma: root mean square of error / sigma along the ray, of the points that are not wrong.
        rings: by the distance to an edge, see :data:`RINGS`.
    """

    covered: float
    wrong: float
    wrong_alone: float
    false_surfaces: int
    false_points: int
    rms_mm: float
    error_to_sigma: float
    rings: dict[str, Ring]


def point_errors(
    xyz: NDArray[np.float32], sigma_mm: NDArray[np.float32], truth: Truth, volume_mm: tuple[float, float]
) -> PointErrors:
    """Figures of a cloud (H, W, 3) with its sigma (H, W), both mm; ``volume_mm``: range of depth to be measured."""
    valid = np.isfinite(xyz[..., 2])
    error = distance_mm(xyz, truth)
    with np.errstate(invalid="ignore"):
        wrong = valid & ~(error <= WRONG_MM)
        good = valid & (error < RIGHT_MM)
        depth = truth.xyz[..., 2]
        measurable = truth.scorable & (depth >= volume_mm[0]) & (depth <= volume_mm[1])
        ray = np.linalg.norm(truth.xyz, axis=-1) / depth
        ratio = np.abs(xyz[..., 2] - depth) * ray / sigma_mm
    surfaces = false_surfaces(xyz[..., 2], wrong)
    edges = distance_to_edge(truth, measurable)
    rings = {}
    for name, least, limit in RINGS:
        ring = (edges >= least) & (edges < limit)
        rings[name] = Ring(
            _share(good & measurable & ring, measurable & ring),
            _share(wrong & ring, valid & ring),
            _rms(ratio[valid & ~wrong & ring]),
        )
    return PointErrors(
        covered=_share(good & measurable, measurable),
        wrong=_share(wrong, valid),
        wrong_alone=_share(wrong & ~_near_a_neighbour(xyz, truth), valid),
        false_surfaces=len(surfaces),
        false_points=sum(surfaces),
        rms_mm=_rms(error[good]),
        error_to_sigma=_rms(ratio[valid & ~wrong]),
        rings=rings,
    )


def distance_mm(xyz: NDArray[np.float32], truth: Truth) -> Floats:
    """Distance of each point (H, W) from the truth of its pixel, mm; NaN where one of them is missing."""
    return np.asarray(np.linalg.norm(xyz.astype(np.float64) - truth.xyz, axis=-1))


def false_surfaces(depth: NDArray[np.float32], wrong: Bools) -> list[int]:
    """Sizes of the false surfaces: 4-connected by steps below 3 mm, 30 pixels or more, at least half of them wrong."""
    labels = surface_labels(depth)
    count = np.bincount(labels.ravel())
    bad = np.bincount(labels.ravel(), weights=wrong.ravel())
    sizes = count[(count >= SURFACE_PIXELS) & (2 * bad >= count) & (np.arange(len(count)) > 0)]
    return [int(size) for size in sizes]


def surface_labels(depth: NDArray[np.float32]) -> NDArray[np.int64]:
    """Label of the 4-connected surface that each pixel (H, W) belongs to; 0 = no point."""
    # Pixels and the links between them on one grid of twice the size, labelled by OpenCV.
    rows, columns = depth.shape
    grid = np.zeros((2 * rows - 1, 2 * columns - 1), np.uint8)
    grid[::2, ::2] = np.isfinite(depth)
    with np.errstate(invalid="ignore"):
        grid[::2, 1::2] = np.abs(np.diff(depth, axis=1)) < SURFACE_STEP_MM
        grid[1::2, ::2] = np.abs(np.diff(depth, axis=0)) < SURFACE_STEP_MM
    return np.asarray(cv2.connectedComponents(grid, connectivity=4)[1][::2, ::2], dtype=np.int64)


def distance_to_edge(truth: Truth, measurable: Bools) -> Floats:
    """Distance (H, W) of each pixel to the nearest depth edge or end of what can be measured, pixels; 1 = beside it."""
    depth = np.where(truth.hit, truth.xyz[..., 2], np.float32(1e9))
    edge = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        step = (np.abs(np.diff(depth, axis=axis)) > SURFACE_STEP_MM) | np.diff(measurable, axis=axis)
        before, after = (slice(None, -1), slice(1, None)) if axis == 0 else (np.s_[:, :-1], np.s_[:, 1:])
        edge[before] |= step
        edge[after] |= step
    return np.asarray(cv2.distanceTransform((~edge).astype(np.uint8), cv2.DIST_L2, 5), dtype=np.float64) + 1


def _near_a_neighbour(xyz: NDArray[np.float32], truth: Truth) -> Bools:
    """Points that the truth of one of the nine pixels around explains within 6 mm, (H, W)."""
    rows, columns = truth.hit.shape
    padded = np.pad(truth.xyz[..., 2], 1, constant_values=np.nan)
    near = np.zeros((rows, columns), bool)
    for i in range(3):
        for j in range(3):
            with np.errstate(invalid="ignore"):
                near |= np.abs(xyz[..., 2] - padded[i : i + rows, j : j + columns]) <= WRONG_MM
    return near


def _share(part: Bools, whole: Bools) -> float:
    return int(np.count_nonzero(part)) / max(1, int(np.count_nonzero(whole)))


def _rms(values: NDArray[np.float64]) -> float:
    values = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
