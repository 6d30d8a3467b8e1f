"""Kalibr's camchain.yaml: cam0 is the left camera, cam1 the right one; pinhole, radtan, metres."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import yaml

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange.common import (
    Imported,
    Named,
    fewer_terms,
    five,
    lost,
    named,
    numbers,
    orthonormal,
    yaml_mapping,
)
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel


def read(files: Sequence[Named]) -> Imported:
    """Cameras out of one camchain."""
    if len(files) != 1:
        raise SourceError(f"{len(files)} files; a Kalibr camchain is one file")
    chain, name = yaml_mapping(files[0]), files[0].name
    left, right = (_device(chain, key, side, name) for key, side in (("cam0", "left"), ("cam1", "right")))
    notes = [f"{name}: {key} is left out; two cameras are a rig" for key in chain if key not in ("cam0", "cam1")]
    with named(name):
        return Imported(Cameras(left, right), "kalibr", notes)


def write(cameras: Cameras) -> tuple[dict[str, bytes], list[str]]:
    """``camchain.yaml``; what radtan cannot hold (k3, skew) is fitted away, with a note of what that costs."""
    chain: dict[str, Any] = {}
    notes: list[str] = []
    for number, (side, device) in enumerate((("left", cameras.left), ("right", cameras.right))):
        kept, error_px = fewer_terms(device, k3=False)
        notes += lost(side, error_px, "Kalibr's radtan", "k3 and no skew")
        m = kept.matrix
        entry: dict[str, Any] = {
            "camera_model": "pinhole",
            "intrinsics": [float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2])],
            "distortion_model": "radtan",
            "distortion_coeffs": kept.distortion[:4].tolist(),
            "resolution": list(kept.size),
            "rostopic": f"/{side}/image_raw",
            "cam_overlaps": [1 - number],
        }
        if number == 1:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = kept.rotation, kept.translation / 1000
            entry["T_cn_cnm1"] = pose.tolist()
        chain[f"cam{number}"] = entry
    data = yaml.safe_dump(chain, sort_keys=False, default_flow_style=None, width=200).encode()
    return {"camchain.yaml": data}, notes


def _device(chain: Mapping[str, Any], key: str, side: str, name: str) -> CameraModel:
    entry = chain.get(key)
    if not isinstance(entry, Mapping):
        raise SourceError(f"{name}: {key} is missing")
    place = f"{name}: {key}"
    for what, known in (("camera_model", "pinhole"), ("distortion_model", "radtan")):
        if entry.get(what) != known:
            raise SourceError(f"{place}: {what} is {entry.get(what)!r:.40}, only {known} can be used here")
    fx, fy, cx, cy = numbers(entry, "intrinsics", (4,), place)
    width, height = numbers(entry, "resolution", (2,), place)
    distortion = five(numbers(entry, "distortion_coeffs", (4,), place), place)
    pose = {}
    if side == "right":
        transform = numbers(entry, "T_cn_cnm1", (16,), place).reshape(4, 4)
        pose["rotation"] = orthonormal(transform[:3, :3], f"{place}: T_cn_cnm1")
        pose["translation"] = 1000 * transform[:3, 3]
    matrix = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]])
    with named(name):
        return CameraModel((int(width), int(height)), matrix, distortion, **pose, name=side)
