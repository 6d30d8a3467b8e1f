"""Kalibr's camchain.yaml: cam0 is the left camera, cam1 the right one; pinhole, radtan, metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

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


def read(files: Sequence[NamedFile]) -> ImportedCameras:
    """Read the cameras of one camchain."""
    if len(files) != 1:
        raise SourceError(f"{len(files)} files; a Kalibr camchain is one file")
    chain, name = yaml_mapping(files[0]), files[0].name
    left, right = (_device(chain, key, side, name) for key, side in (("cam0", "left"), ("cam1", "right")))
    notes = [f"{name}: {key} is left out; a rig has two cameras" for key in chain if key not in ("cam0", "cam1")]
    with naming_file(name):
        return ImportedCameras(Cameras(left, right), "kalibr", notes)


def write(cameras: Cameras) -> tuple[dict[str, bytes], list[str]]:
    """``camchain.yaml``; terms that radtan lacks (k3, skew) are approximated, with a note of the error."""
    chain: dict[str, Any] = {}
    notes: list[str] = []
    for number, (side, device) in enumerate((("left", cameras.left), ("right", cameras.right))):
        reduced, error_px = fewer_terms(device, k3=False)
        notes += loss_note(side, error_px, "Kalibr's radtan", "k3 and no skew")
        m = reduced.matrix
        entry: dict[str, Any] = {
            "camera_model": "pinhole",
            "intrinsics": [float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": reduced.distortion[:4].tolist(),
            "resolution": list(reduced.size),
            "rostopic": f"/{side}/image_raw",
            "cam_overlaps": [1 - number],
        }
        if number == 1:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = reduced.rotation, reduced.translation / 1000
            entry["T_cn_cnm1"] = pose.tolist()
        chain[f"cam{number}"] = entry
    data = yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=200).encode()
    return {"camchain.yaml": data}, notes


def _device(chain: Mapping[str, Any], key: str, side: str, name: str) -> CameraModel:
    entry = chain.get(key)
    if not isinstance(entry, Mapping):
        raise SourceError(f"{name}: {key} is missing")
    path = f"{name}: {key}"
    for model, supported in (("camera_model", "pinhole"), ("distortion_model", "radtan")):
        if entry.get(model) != supported:
            raise SourceError(f"{path}: {model} is {entry.get(model)!r:.40}, only {supported} is supported")
    fx, fy, cx, cy = numbers(entry, "intrinsics", (4,), path)
    width, height = numbers(entry, "resolution", (2,), path)
    distortion = five_coefficients(numbers(entry, "distortion_coeffs", (4,), path), path)
    pose = {}
    if side == "right":
        transform = numbers(entry, "T_cn_cnm1", (16,), path).reshape(4, 4)
        pose["rotation"] = orthonormal(transform[:3, :3], f"{path}: T_cn_cnm1")
        pose["translation"] = 1000 * transform[:3, 3]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    with naming_file(name):
        return CameraModel((int(width), int(height)), matrix, distortion, **pose, name=side)
