"""Common parts of the formats: named files, numbers of a mapping, the nearest camera model with fewer terms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.calibration.errors import SourceError
from daemon.rig.calibration_file import load_mapping
from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import Cameras
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]
_GRID = 41


@dataclass(frozen=True, slots=True)
class NamedFile:
    """The bytes of a file and its name in messages."""

    name: str
    data: bytes


@dataclass(frozen=True, slots=True, eq=False)
class ImportedCameras:
    """Cameras read from another program's files; ``notes`` are whole sentences about their peculiarities."""

    cameras: Cameras
    form: str
    notes: list[str] = field(default_factory=list)


def yaml_mapping(file: NamedFile) -> dict[str, Any]:
    """The keys and values of a YAML file."""
    try:
        return load_mapping(file.data, file.name)
    except CalibrationError as error:
        raise SourceError(str(error)) from error


def numbers(mapping: Mapping[str, Any], key: str, count: tuple[int, ...], name: str) -> Array:
    """Read a flat array of numbers of one of the lengths ``count``; nested lists are flattened."""
    if key not in mapping:
        raise SourceError(f"{name}: {key} is missing")
    try:
        array = np.array(mapping[key], dtype=np.float64).ravel()
    except (TypeError, ValueError) as error:
        raise SourceError(f"{name}: {key} is not a list of numbers") from error
    if len(array) not in count or not np.isfinite(array).all():
        expected = " or ".join(str(n) for n in count)
        raise SourceError(f"{name}: {key} has {len(array)} numbers, expected {expected} finite ones")
    return array


def five_coefficients(coefficients: Array, name: str) -> Array:
    """k1, k2, p1, p2, k3 of a list of 4 or more; SourceError if another coefficient is not zero."""
    if len(coefficients) > 5 and np.abs(coefficients[5:]).max() > 0:
        raise SourceError(
            f"{name}: {len(coefficients)} distortion coefficients; only k1, k2, p1, p2, k3 are supported: "
            "calibrate again without the rational, thin-prism and tilted models"
        )
    return np.concatenate([coefficients, np.zeros(5)])[:5]


def orthonormal(rotation: Array, name: str) -> Array:
    """The nearest rotation; SourceError if the matrix differs from it by more than rounding."""
    u, _, vt = np.linalg.svd(rotation)
    nearest = u @ vt
    away = float(np.abs(nearest - rotation).max())
    if away > 1e-3 or np.linalg.det(nearest) < 0:
        raise SourceError(f"{name}: not a rotation (off by {away:.2g}, determinant {np.linalg.det(rotation):.3f})")
    return np.asarray(nearest)


@contextmanager
def naming_file(name: str) -> Iterator[None]:
    """Prefix the errors of a camera model with the file's name."""
    try:
        yield
    except CalibrationError as error:
        raise SourceError(f"{name}: {error}") from error


def fewer_terms(device: CameraModel, *, k3: bool) -> tuple[CameraModel, float]:
    """The device without skew, and without k3 unless ``k3``, fitted to its image.

    Pixels are linear in fx, cx and in their products with the coefficients; the fit keeps the focal lengths and
    the principal point and estimates the coefficients.

    Returns:
        The device, and the largest distance in pixels between its image and the true one.
    """
    bare = device.matrix.copy()
    bare[0, 1] = 0.0
    if device.matrix[0, 1] == 0 and (k3 or device.distortion[4] == 0):
        return device, 0.0
    width, height = device.size
    v, u = np.meshgrid(np.linspace(0, height - 1, _GRID), np.linspace(0, width - 1, _GRID), indexing="ij")
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    ideal = device.normalise(pixels)
    target = np.stack([(pixels[:, 0] - bare[0, 2]) / bare[0, 0], (pixels[:, 1] - bare[1, 2]) / bare[1, 1]], axis=1)
    x, y = ideal.T
    r2 = x * x + y * y
    columns = [(x * r2, y * r2), (x * r2**2, y * r2**2), (2 * x * y, r2 + 2 * y * y), (r2 + 2 * x * x, 2 * x * y)]
    columns += [(x * r2**3, y * r2**3)] if k3 else []
    matrix = np.stack([np.concatenate(pair) for pair in columns], axis=1)
    coefficients = np.linalg.lstsq(matrix, (target - ideal).T.ravel(), rcond=None)[0]
    fitted = CameraModel(
        device.size,
        bare,
        np.concatenate([coefficients, np.zeros(5)])[:5],
        device.rotation,
        device.translation,
        device.name,
    )
    shift = fitted.to_pixels(fitted.distort(ideal)) - pixels
    return fitted, float(np.linalg.norm(shift, axis=1).max())


def loss_note(side: str, error_px: float, form: str, terms: str) -> list[str]:
    """The note about terms that a format cannot represent; none if nothing is lost."""
    if error_px == 0.0:
        return []
    return [f"{side}: {form} has no {terms}; without them its image differs by up to {error_px:.3f} px"]
