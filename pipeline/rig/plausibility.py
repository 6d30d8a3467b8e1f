"""Limits of what a calibrated rig can be: a file beyond them holds a mistake of unit, key or device."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume

Array = NDArray[np.float64]

FOCAL_TO_WIDTH = (0.2, 40.0)
"""Focal length over image width."""
FOCAL_RATIO = (0.7, 1.43)
"""fx over fy."""
CENTRE_CAMERA, CENTRE_PROJECTOR = (0.15, 0.85), (-1.0, 2.0)
"""Principal point as a share of the image's size; a projector's lens is often shifted."""
LARGEST_DISTORTION = 0.5
"""Displacement of the image's corner by distortion over its distance from the principal point."""
BASELINE_MM = (5.0, 20_000.0)
BASELINE_TO_DISTANCE = (0.005, 4.0)
LARGEST_ANGLE_DEG = 100.0
"""Between the optical axes of two devices."""

KEYS: dict[str, tuple[str, ...]] = {
    "": ("fringed_calibration", "created", "cameras", "projector", "quality"),
    "cameras": ("left", "right"),
    "cameras.*": ("serial", "size", "matrix", "distortion", "rotation", "translation", "color"),
    "cameras.*.color": ("black", "crosstalk", "balance", "lateral"),
    "projector": ("size", "matrix", "distortion", "rotation", "translation", "response", "registration"),
    "projector.response": ("levels", "red", "green", "blue"),
}
"""Keys of a calibration file by the place that they stand in."""
_ALIKE = 0.75


def check_rig(left: CameraModel, right: CameraModel, projector: CameraModel | None) -> None:
    """Refuse what no rig can be.

    Raises:
        CalibrationError: with every value that is outside its limits, by its key in the file.
    """
    problems = [*_device("cameras.left", left, CENTRE_CAMERA), *_device("cameras.right", right, CENTRE_CAMERA)]
    others = [("cameras.right", right)]
    if projector is not None:
        problems += _device("projector", projector, CENTRE_PROJECTOR)
        others.append(("projector", projector))
    for key, device in others:
        distance = float(np.linalg.norm(device.centre - left.centre))
        if not BASELINE_MM[0] <= distance <= BASELINE_MM[1]:
            problems.append(
                f"{key}.translation: {distance:.4g} mm from the left camera, limits {BASELINE_MM[0]:g} and "
                f"{BASELINE_MM[1]:g} mm; translations are in millimetres"
            )
        angle = float(np.degrees(np.arccos(np.clip(device.rotation[2, 2], -1.0, 1.0))))
        if angle > LARGEST_ANGLE_DEG:
            problems.append(
                f"{key}.rotation: its optical axis is {angle:.1f} degrees from the left camera's, limit "
                f"{LARGEST_ANGLE_DEG:g}"
            )
    if problems:
        raise CalibrationError("; ".join(problems))


def check_volume(left: CameraModel, right: CameraModel, volume: Volume) -> None:
    """Refuse a measuring volume that does not belong to this rig; CalibrationError with value and limit."""
    baseline = float(np.linalg.norm(right.centre - left.centre))
    middle = 0.5 * (volume.near_mm + volume.far_mm)
    least, most = BASELINE_TO_DISTANCE
    if not least <= baseline / middle <= most:
        raise CalibrationError(
            f"volume: its middle is {middle:.4g} mm away and the baseline is {baseline:.4g} mm, ratio "
            f"{baseline / middle:.3g}, limits {least:g} and {most:g}; both are in millimetres"
        )
    width, height = left.size
    ray = left.normalise(np.array([[0.5 * (width - 1), 0.5 * (height - 1)]]))[0]
    points = np.array([[ray[0] * z, ray[1] * z, z] for z in np.linspace(volume.near_mm, volume.far_mm, 5)])
    pixels = right.project(points)
    size = np.array(right.size)
    if not ((pixels >= -0.5 * size) & (pixels <= 1.5 * size)).any(axis=0).all():
        raise CalibrationError(
            "volume: the right camera sees nothing of what the left camera's middle shows between "
            f"{volume.near_mm:g} and {volume.far_mm:g} mm; check the volume and cameras.right"
        )


def check_keys(data: Mapping[str, Any]) -> None:
    """Refuse keys that are a known key misspelt; other unknown keys are left alone.

    Raises:
        CalibrationError: the key, and the one that is meant.
    """
    problems = list(_misspelt(data, "", ""))
    if problems:
        raise CalibrationError("; ".join(problems))


def _misspelt(data: Mapping[str, Any], place: str, pattern: str) -> Iterator[str]:
    known = KEYS[pattern]
    for key, value in data.items():
        name = f"{place}.{key}".lstrip(".")
        below = f"{pattern}.{key}".lstrip(".") if pattern != "cameras" else "cameras.*"
        if key not in known:
            near = difflib.get_close_matches(str(key).lower(), [k for k in known if k not in data], 1, _ALIKE)
            if near:
                yield f"{name} is no key of a calibration; write {near[0]}"
        elif below in KEYS and isinstance(value, Mapping):
            yield from _misspelt(value, name, below)


def _device(name: str, device: CameraModel, centre: tuple[float, float]) -> Iterator[str]:
    width, height = device.size
    fx, fy = device.matrix[0, 0], device.matrix[1, 1]
    if not FOCAL_TO_WIDTH[0] <= fx / width <= FOCAL_TO_WIDTH[1]:
        yield (
            f"{name}.matrix: focal length {fx:.4g} px for a width of {width} px, limits "
            f"{FOCAL_TO_WIDTH[0] * width:.4g} and {FOCAL_TO_WIDTH[1] * width:.4g} px"
        )
    if not FOCAL_RATIO[0] <= fx / fy <= FOCAL_RATIO[1]:
        yield f"{name}.matrix: fx / fy is {fx / fy:.3g}, limits {FOCAL_RATIO[0]:g} and {FOCAL_RATIO[1]:g}"
    for axis, side, value in (("cx", width, device.matrix[0, 2]), ("cy", height, device.matrix[1, 2])):
        if not centre[0] * side <= value <= centre[1] * side:
            yield (
                f"{name}.matrix: {axis} is {value:.4g} px, limits {centre[0] * side:.4g} and {centre[1] * side:.4g} px"
            )
    share = _distortion_at_the_corners(device)
    if not share <= LARGEST_DISTORTION:
        yield (
            f"{name}.distortion: it displaces the image's corner by {share:.3g} of its distance from the centre, "
            f"limit {LARGEST_DISTORTION:g}"
        )


def _distortion_at_the_corners(device: CameraModel) -> float:
    """Largest displacement over the radius of what an ideal lens shows in the corners; inf where the image folds."""
    width, height = device.size
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    m = device.matrix
    y = (corners[:, 1] - m[1, 2]) / m[1, 1]
    x = (corners[:, 0] - m[0, 2] - m[0, 1] * y) / m[0, 0]
    # An ideal point a little beyond the corner must still be further out than one within: the image must not fold.
    scales = np.linspace(0.1, 1.0, 10)[:, None, None]
    ideal = scales * np.stack([x, y], axis=-1)
    seen = device.distort(ideal)
    radius, true = np.linalg.norm(seen, axis=-1), np.linalg.norm(ideal, axis=-1)
    if not np.isfinite(seen).all() or (np.diff(radius, axis=0) <= 0).any():
        return float("inf")
    return float((np.linalg.norm(seen - ideal, axis=-1) / np.maximum(true, 1e-12)).max())
