"""A pair of ROS camera_info files (plumb_bob); the pose of the cameras is in their rectification, in metres.

With the rectifying rotations ``R1``, ``R2`` and the right projection matrix, whose fourth column is ``-fx B``
(sensor_msgs/CameraInfo), ``X_right = R2^T (R1 X_left + (P[0, 3], P[1, 3], 0) / f)``. Nothing of the pose is lost.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange.common import (
    ImportedCameras,
    NamedFile,
    fewer_terms,
    five_coefficients,
    loss_note,
    naming_file,
    numbers,
    orthonormal,
    yaml_mapping,
)
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]


def read(files: Sequence[NamedFile]) -> ImportedCameras:
    """Read the cameras from the left and the right file, in this order."""
    if len(files) != 2:
        raise SourceError(f"{len(files)} files, ROS has one for each camera: give the left one, then the right one")
    infos = [yaml_mapping(file) for file in files]
    left, right = (_intrinsics(info, file.name) for info, file in zip(infos, files, strict=True))
    rectify = [
        orthonormal(_matrix(info, "rectification_matrix", 9, file.name).reshape(3, 3), f"{file.name}: rectification")
        for info, file in zip(infos, files, strict=True)
    ]
    across = [_across(info, file.name) for info, file in zip(infos, files, strict=True)]
    if abs(across[0]).max() > 0 and abs(across[1]).max() == 0:
        raise SourceError(
            f"{files[0].name}: its projection_matrix contains the baseline: this is the right camera's file"
        )
    if abs(across[1]).max() == 0:
        raise SourceError(f"{files[1].name}: projection_matrix contains no baseline; the files are no stereo pair")
    rotation = rectify[1].T @ rectify[0]
    translation = 1000 * rectify[1].T @ (across[1] - across[0])
    with naming_file(files[1].name):
        placed = CameraModel(right.size, right.matrix, right.distortion, rotation, translation, "right")
        return ImportedCameras(
            Cameras(CameraModel(left.size, left.matrix, left.distortion, name="left"), placed), "ros"
        )


def write(cameras: Cameras) -> tuple[dict[str, bytes], list[str]]:
    """``left.yaml`` and ``right.yaml``, rectified as cv2.stereoRectify does (zero disparity at infinity)."""
    notes: list[str] = []
    devices = []
    for side, device in (("left", cameras.left), ("right", cameras.right)):
        reduced, error_px = fewer_terms(device, k3=True)
        notes += loss_note(side, error_px, "ROS plumb_bob", "skew")
        devices.append(reduced)
    left, right = devices
    r1, r2, p1, p2, *_ = cv2.stereoRectify(
        left.matrix, left.distortion, right.matrix, right.distortion, left.size, right.rotation,
        right.translation[:, None] / 1000, flags=cv2.CALIB_ZERO_DISPARITY, alpha=-1,
    )  # fmt: skip
    files = {}
    for side, device, rectification, projection in (("left", left, r1, p1), ("right", right, r2, p2)):
        info = {
            "image_width": device.size[0],
            "image_height": device.size[1],
            "camera_name": side,
            "camera_matrix": _rows(device.matrix),
            "distortion_model": "plumb_bob",
            "distortion_coefficients": _rows(device.distortion[None]),
            "rectification_matrix": _rows(rectification),
            "projection_matrix": _rows(projection),
        }
        files[f"{side}.yaml"] = yaml.safe_dump(info, sort_keys=False, default_flow_style=None).encode()
    return files, notes


def _rows(matrix: Any) -> dict[str, Any]:
    rows, columns = matrix.shape
    return {"rows": rows, "cols": columns, "data": np.asarray(matrix, dtype=np.float64).ravel().tolist()}


def _matrix(info: Mapping[str, Any], key: str, count: int, name: str) -> Array:
    entry = info.get(key)
    return numbers({key: entry.get("data") if isinstance(entry, Mapping) else entry}, key, (count,), name)


def _across(info: Mapping[str, Any], name: str) -> Array:
    """Shift of the rectified frame from the left camera's, (3,), metres."""
    projection = _matrix(info, "projection_matrix", 12, name).reshape(3, 4)
    if min(projection[0, 0], projection[1, 1]) <= 0:
        raise SourceError(f"{name}: projection_matrix has no positive focal length")
    return np.array([projection[0, 3] / projection[0, 0], projection[1, 3] / projection[1, 1], 0.0])


def _intrinsics(info: Mapping[str, Any], name: str) -> CameraModel:
    if info.get("distortion_model") != "plumb_bob":
        raise SourceError(
            f"{name}: distortion_model is {info.get('distortion_model')!r:.40}, only plumb_bob is supported"
        )
    entry = info.get("distortion_coefficients")
    coefficients = entry.get("data") if isinstance(entry, Mapping) else entry
    distortion = numbers({"distortion_coefficients": coefficients}, "distortion_coefficients", (4, 5), name)
    sizes = [int(numbers(info, key, (1,), name)[0]) for key in ("image_width", "image_height")]
    matrix = _matrix(info, "camera_matrix", 9, name).reshape(3, 3)
    with naming_file(name):
        return CameraModel((sizes[0], sizes[1]), matrix, five_coefficients(distortion, name))
