"""OpenCV's FileStorage (YAML, XML, JSON) with the key names of its samples: M1 D1 M2 D2 R T, cameraMatrix1 and so on.

OpenCV also has ``X_right = R X_left + T``, (0, 0) at the centre of the first pixel, and the coefficients k1, k2, p1,
p2, k3. Its functions ignore the skew.
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.exchange.common import (
    ImportedCameras,
    NamedFile,
    fewer_terms,
    five_coefficients,
    loss_note,
    naming_file,
    orthonormal,
)
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

_MATRIX = ("M{}", "cameraMatrix{}", "camera_matrix_{}", "K{}")
_DISTORTION = ("D{}", "distCoeffs{}", "dist_coeffs_{}", "distortion_coefficients_{}")
_SIZE = ("imageSize{}", "image_size_{}", "imageSize", "image_size", "size")
_SIDES = {1: "left", 2: "right", 3: "projector"}
_ROTATION = {2: ("R", "R12", "rotation"), 3: ("R13",)}
_TRANSLATION = {2: ("T", "T12", "translation"), 3: ("T13",)}


def read(files: Sequence[NamedFile], *, size: tuple[int, int] | None = None, unit_mm: float = 1.0) -> ImportedCameras:
    """Read the cameras, and a projector given as device 3, from one or more files."""
    values: dict[str, Array] = {}
    for file in files:
        values |= _matrices(file)
    name = ", ".join(file.name for file in files)
    left = _device(values, 1, name, size, unit_mm)
    right = _device(values, 2, name, size, unit_mm)
    with_third = any(key.format(3) in values for key in _MATRIX)
    projector = _device(values, 3, name, None, unit_mm) if with_third else None
    with naming_file(name):
        return ImportedCameras(Cameras(left, right, projector=projector), "opencv")


def write(cameras: Cameras) -> tuple[dict[str, bytes], list[str]]:
    """``stereo.yml`` with M1 D1 M2 D2 R T, the sizes and a projector as device 3; mm."""
    storage = cv2.FileStorage("stereo.yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    notes: list[str] = []
    for number, device in enumerate([cameras.left, cameras.right, cameras.projector], 1):
        if device is None:
            continue
        reduced, error_px = fewer_terms(device, k3=True)
        notes += loss_note(_SIDES[number], error_px, "OpenCV", "skew")
        storage.write(f"imageSize{number}", np.array([reduced.size], dtype=np.float64))
        storage.write(f"M{number}", reduced.matrix)
        storage.write(f"D{number}", reduced.distortion[None])
        if number > 1:
            storage.write(_ROTATION[number][0], reduced.rotation)
            storage.write(_TRANSLATION[number][0], reduced.translation[:, None])
    return {"stereo.yml": storage.releaseAndGetString().encode()}, notes


def _matrices(file: NamedFile) -> dict[str, Array]:
    """Every matrix and list of numbers at the top of a file."""
    storage = cv2.FileStorage()
    try:
        text = file.data.decode("utf-8")
        if not storage.open(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY):
            raise SourceError(f"{file.name}: not a cv2.FileStorage file")
        root = storage.root()
        matrices = {}
        for key in root.keys():  # noqa: SIM118 - a FileNode is no mapping
            node = root.getNode(key)
            value = _numbers_of(node)
            if value is not None:
                matrices[key] = value
    except (cv2.error, UnicodeDecodeError, SystemError) as error:
        raise SourceError(f"{file.name}: not a cv2.FileStorage file") from error
    finally:
        storage.release()
    return matrices


def _numbers_of(node: cv2.FileNode) -> Array | None:
    if node.isMap():
        matrix = node.mat()
        return None if matrix is None else np.array(matrix, dtype=np.float64)
    if node.isSeq() and node.size() <= 64:
        items = [node.at(number) for number in range(node.size())]
        if all(item.isInt() or item.isReal() for item in items):
            return np.array([item.real() for item in items])
    if node.isInt() or node.isReal():
        return np.array([node.real()])
    return None


def _device(
    values: dict[str, Array], number: int, name: str, size: tuple[int, int] | None, unit_mm: float
) -> CameraModel:
    matrix = _first(values, [key.format(number) for key in _MATRIX], (9,), name).reshape(3, 3)
    keys = [key.format(number) for key in _DISTORTION]
    distortion = _first(values, keys, (4, 5, 8, 12, 14), name)
    side = _SIDES[number]
    pose = {}
    if number > 1:
        rotation = _first(values, _ROTATION[number], (9, 3), name)
        if len(rotation) == 3:  # some programs write a rotation vector
            rotation = np.asarray(cv2.Rodrigues(rotation)[0], dtype=np.float64)
        pose["rotation"] = orthonormal(rotation.reshape(3, 3), f"{name}: {_ROTATION[number][0]}")
        pose["translation"] = unit_mm * _first(values, _TRANSLATION[number], (3,), name)
    bare = matrix.copy()
    bare[2] = 0, 0, 1
    with naming_file(name):
        return CameraModel(
            _size(values, number, name, size), bare, five_coefficients(distortion, f"{name}: {side}"), **pose, name=side
        )


def _size(values: dict[str, Array], number: int, name: str, size: tuple[int, int] | None) -> tuple[int, int]:
    for key in _SIZE:
        value = values.get(key.format(number))
        if value is not None and value.size == 2:
            return int(value.ravel()[0]), int(value.ravel()[1])
    if "image_width" in values and "image_height" in values:
        return int(values["image_width"][0]), int(values["image_height"][0])
    if size is None:
        raise SourceError(f"{name}: it does not contain the size of the images; give --size WIDTHxHEIGHT")
    return size


def _first(values: dict[str, Array], keys: Sequence[str], count: tuple[int, ...], name: str) -> Array:
    for key in keys:
        if key in values:
            value = values[key].ravel()
            if len(value) not in count or not np.isfinite(value).all():
                expected = " or ".join(str(n) for n in count)
                raise SourceError(f"{name}: {key} has {len(value)} numbers, expected {expected} finite ones")
            return value
    raise SourceError(f"{name}: {keys[0]} is missing (other accepted names: {', '.join(keys[1:])})")
