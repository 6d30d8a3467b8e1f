"""Figures of a solution for the file and the report: coverage, errors by view, values by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.state import INTRINSICS, POSE, intrinsics_of
from pipeline.calibrate.bundle.quality.reprojection_error import epipolar_distances
from pipeline.calibrate.bundle.solution import Solution
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class ViewFigures:
    """Errors of one view, px: rms by device, and the mean epipolar distance (NaN where only one camera detected it)."""

    name: str
    rms: dict[str, float]
    marks: dict[str, int]
    epipolar_px: float


def view_figures(solution: Solution) -> list[ViewFigures]:
    """Of every view that was used."""
    out = []
    for name, pose in zip(solution.views, solution.poses, strict=True):
        if pose is None:
            continue
        rms, marks = {}, {}
        for device in solution.devices:
            residuals = solution.residuals.get((name, device))
            if residuals is not None and len(residuals.ids):
                rms[device] = float(np.sqrt((residuals.misfit**2).sum(axis=1).mean()))
                marks[device] = len(residuals.ids)
        out.append(ViewFigures(name, rms, marks, _epipolar(solution, name, pose)))
    return out


def _epipolar(solution: Solution, name: str, pose: tuple[Array, Array]) -> float:
    """Mean distance of the marks, as points, from their partners' epipolar lines."""
    world = solution.board_points @ pose[0].T + pose[1]
    positions: list[dict[int, Array]] = []
    for device in ("left", "right"):
        residuals = solution.residuals.get((name, device))
        if residuals is None:
            return float("nan")
        points = solution.devices[device].project(world)
        # The adjustment may have renumbered the marks: each is the one whose image is nearest to its prediction.
        predicted = residuals.pixels - residuals.misfit
        marks = np.linalg.norm(predicted[:, None] - points[None], axis=2).argmin(axis=1)
        # The image of the mark's point plus the residual: a point, no centroid.
        positions.append(dict(zip(marks.tolist(), points[marks] + residuals.misfit, strict=True)))
    both = sorted(positions[0].keys() & positions[1].keys())
    if not both:
        return float("nan")
    in_left, in_right = (np.array([pixels[mark] for mark in both]) for pixels in positions)
    return float(epipolar_distances(solution.devices["left"], solution.devices["right"], in_left, in_right).mean())


def values_of(cameras: Cameras) -> dict[str, float]:
    """Parameters by the names of :attr:`pipeline.calibrate.bundle.Solution.values`."""
    out: dict[str, float] = {"baseline_mm": cameras.baseline_mm}
    for name, device in (("left", cameras.left), ("right", cameras.right), ("projector", cameras.projector)):
        if device is not None:
            out |= {f"{name}.{key}": value for key, value in device_values(device).items()}
    axes = cameras.left.rotation[2] @ cameras.right.rotation[2]
    out["angle_deg"] = float(np.degrees(np.arccos(np.clip(axes, -1, 1))))
    return out


def device_values(device: CameraModel) -> dict[str, float]:
    """The sixteen numbers of one device."""
    vector = np.asarray(cv2.Rodrigues(device.rotation)[0]).ravel()
    values = [*intrinsics_of(device), *vector, *device.translation]
    return dict(zip((*INTRINSICS, *POSE), map(float, values), strict=True))


def quality_of(solution: Solution, *, board: str, coverage: Mapping[str, float]) -> dict[str, Any]:
    """The ``quality`` part of the calibration file; ``coverage``: share of each device's image covered by marks."""
    quality: dict[str, Any] = dict(solution.quality())
    quality |= {f"coverage_{device}": round(share, 3) for device, share in coverage.items()}
    quality["board"] = board
    if solution.diameter_mm:
        quality["diameter_mm"] = round(solution.diameter_mm, 4)
    quality["scale"] = solution.scale
    quality["standard_deviations"] = {
        name: float(f"{value:.3g}") for name, value in solution.sigma.items() if value > 0 and np.isfinite(value)
    }
    quality["views"] = [
        {"name": view.name}
        | {f"rms_{device}_px": round(value, 4) for device, value in view.rms.items()}
        | ({"epipolar_px": round(view.epipolar_px, 4)} if np.isfinite(view.epipolar_px) else {})
        for view in view_figures(solution)
    ]
    return quality
