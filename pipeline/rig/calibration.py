"""A calibrated rig: two cameras and a projector in one world, with their colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.lateral_chromatic import LateralChromatic, Registration, lateral_chromatic_of, registration_of
from pipeline.rig.plausibility import check_keys, check_rig

Array = NDArray[np.float64]

VERSION = 1


@dataclass(frozen=True, slots=True, eq=False)
class ColorModel:
    """Black level and crosstalk of a colour camera.

    Args:
        black: (3,) camera counts (8-bit scale), R G B.
        crosstalk: (3, 3), response of camera channel c to projector channel p; ones on the diagonal.
        balance: (3,) responses of the channels to their own full light on a white surface, relative to their mean.
        lateral_chromatic: lateral chromatic aberration of the lens; None = not calibrated.
    """

    black: Array = field(default_factory=lambda: np.zeros(3))
    crosstalk: Array = field(default_factory=lambda: np.eye(3))
    name: str = "color"
    balance: Array = field(default_factory=lambda: np.ones(3))
    lateral_chromatic: LateralChromatic | None = None

    def __post_init__(self) -> None:
        black, crosstalk = np.array(self.black, np.float64), np.array(self.crosstalk, np.float64)
        balance = np.array(self.balance, np.float64)
        if balance.shape != (3,) or not np.isfinite(balance).all() or balance.min() < 0.05 or balance.max() > 3:
            raise CalibrationError(f"{self.name}.balance must be three numbers from 0.05 to 3, R G B, got {balance}")
        if black.shape != (3,) or not np.isfinite(black).all():
            raise CalibrationError(f"{self.name}.black must be three finite numbers, R G B")
        if crosstalk.shape != (3, 3) or not np.isfinite(crosstalk).all():
            raise CalibrationError(f"{self.name}.crosstalk must be 3 x 3 finite numbers")
        if np.abs(np.diag(crosstalk) - 1).max() > 1e-6:
            raise CalibrationError(f"{self.name}.crosstalk must have ones on its diagonal, got {np.diag(crosstalk)}")
        if np.linalg.cond(crosstalk) > 20:
            raise CalibrationError(
                f"{self.name}.crosstalk cannot be inverted safely (condition {np.linalg.cond(crosstalk):.3g}, limit 20)"
            )
        object.__setattr__(self, "black", black)
        object.__setattr__(self, "crosstalk", crosstalk)
        object.__setattr__(self, "balance", balance)

    @property
    def mix(self) -> Array:
        """Response of the camera's channels to the projector's on a white surface, (3, 3): crosstalk and balance."""
        return np.asarray(self.crosstalk * self.balance)

    @property
    def unmix(self) -> Array:
        """The inverse of :attr:`mix`, (3, 3), applied to counts minus black."""
        return np.asarray(np.linalg.inv(self.mix))


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """Relative light of each projector channel (0..1) at drive levels; linear in between.

    Args:
        levels: (n,) rising drive values, first 0, last 255.
        curves: (3, n) red, green, blue; monotone, 1 at the last level.
    """

    levels: Array
    curves: Array

    def __post_init__(self) -> None:
        levels, curves = np.array(self.levels, np.float64), np.array(self.curves, np.float64)
        if levels.ndim != 1 or len(levels) < 2 or curves.shape != (3, len(levels)):
            raise CalibrationError("projector.response needs levels and red, green, blue of one length, at least 2")
        if not (np.isfinite(levels).all() and np.isfinite(curves).all()):
            raise CalibrationError("projector.response holds a value that is not finite")
        if (np.diff(levels) <= 0).any() or levels[0] != 0 or levels[-1] != 255:
            raise CalibrationError("projector.response.levels must rise from 0 to 255")
        if (np.diff(curves, axis=1) < 0).any() or np.abs(curves[:, -1] - 1).max() > 1e-6:
            raise CalibrationError("projector.response: each channel must be monotone and 1 at level 255")
        object.__setattr__(self, "levels", levels)
        object.__setattr__(self, "curves", curves)

    def light(self, drive: Array) -> Array:
        """Light 0..255 of drive values, (..., 3) -> (..., 3)."""
        channels = [255 * np.interp(drive[..., c], self.levels, self.curves[c]) for c in range(3)]
        return np.stack(channels, axis=-1)

    def drive(self, light: Array) -> Array:
        """Drive values 0..255 that give this light 0..255, (..., 3) -> (..., 3)."""
        channels = [np.interp(light[..., c] / 255, self.curves[c], self.levels) for c in range(3)]
        return np.stack(channels, axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Calibration of a rig; the left camera is the world."""

    left: CameraModel
    right: CameraModel
    projector: CameraModel
    left_color: ColorModel = field(default_factory=ColorModel)
    right_color: ColorModel = field(default_factory=ColorModel)
    response: Response | None = None
    registration: Registration | None = None

    def __post_init__(self) -> None:
        offset = max(np.abs(self.left.rotation - np.eye(3)).max(), np.abs(self.left.translation).max())
        if offset > 1e-9:
            raise CalibrationError("cameras.left must have the identity pose: the left camera is the world frame")
        if self.baseline_mm < 1e-9:
            raise CalibrationError("cameras.left and cameras.right have the same position: the baseline is 0 mm")

    @property
    def baseline_mm(self) -> float:
        """Distance of the two cameras' centres."""
        return float(np.linalg.norm(self.right.centre - self.left.centre))

    def swapped(self) -> Calibration:
        """The same rig with the right camera as the world (and called left)."""
        r, t = self.right.rotation, self.right.translation

        def move(device: CameraModel, name: str) -> CameraModel:
            rotation = device.rotation @ r.T
            return CameraModel(
                device.size, device.matrix, device.distortion, rotation, device.translation - rotation @ t, name
            )

        left = CameraModel(self.right.size, self.right.matrix, self.right.distortion, name="left")
        right, projector = move(self.left, "right"), move(self.projector, "projector")
        return Calibration(left, right, projector, self.right_color, self.left_color, self.response, self.registration)


@dataclass(frozen=True, slots=True, eq=False)
class Cameras:
    """The two cameras of a rig, with its projector where that is calibrated too; the left camera is the world."""

    left: CameraModel
    right: CameraModel
    left_color: ColorModel = field(default_factory=ColorModel)
    right_color: ColorModel = field(default_factory=ColorModel)
    projector: CameraModel | None = None
    response: Response | None = None
    registration: Registration | None = None

    def __post_init__(self) -> None:
        # The checks of a complete rig apply to the cameras; any third device completes it.
        Calibration(self.left, self.right, self.projector or self.right)

    @property
    def baseline_mm(self) -> float:
        """Distance of the two cameras' centres."""
        return float(np.linalg.norm(self.right.centre - self.left.centre))

    def complete(self) -> Calibration:
        """The complete calibration; CalibrationError without a projector."""
        if self.projector is None:
            raise CalibrationError(NO_PROJECTOR)
        return Calibration(
            self.left,
            self.right,
            self.projector,
            self.left_color,
            self.right_color,
            self.response,
            self.registration,
        )


NO_PROJECTOR = "projector is missing: run fringed calibrate projector"


def from_mapping(data: Mapping[str, Any]) -> Calibration:
    """Calibration of the plain mapping in a calibration file; errors name the key."""
    return cameras_from_mapping(data).complete()


def cameras_from_mapping(data: Mapping[str, Any]) -> Cameras:
    """The same where the projector may be missing; errors name the key."""
    version = data.get("fringed_calibration")
    if version != VERSION:
        raise CalibrationError(f"fringed_calibration is {version!r}, this program reads version {VERSION}")
    check_keys(data)
    cameras = _mapping(data, "cameras", "")
    left, right = _mapping(cameras, "left", "cameras."), _mapping(cameras, "right", "cameras.")
    projector = _mapping(data, "projector", "") if data.get("projector") is not None else None
    made = Cameras(
        left=_device(left, "cameras.left"),
        right=_device(right, "cameras.right"),
        left_color=_color(left, "cameras.left"),
        right_color=_color(right, "cameras.right"),
        projector=None if projector is None else _device(projector, "projector"),
        response=None if projector is None else _response(projector),
        registration=(
            None
            if projector is None or projector.get("registration") is None
            else registration_of(projector["registration"], "projector.registration")
        ),
    )
    check_rig(made.left, made.right, made.projector)
    return made


def to_mapping(calibration: Calibration | Cameras) -> dict[str, Any]:
    """The plain mapping of a calibration file, without ``created`` and ``quality``."""
    cameras = {}
    for name, device, color in (
        ("left", calibration.left, calibration.left_color),
        ("right", calibration.right, calibration.right_color),
    ):
        colors: dict[str, Any] = {"black": color.black.tolist(), "crosstalk": color.crosstalk.tolist()}
        if (color.balance != 1).any():
            colors["balance"] = color.balance.tolist()
        if color.lateral_chromatic is not None:
            colors["lateral"] = color.lateral_chromatic.as_mapping()
        cameras[name] = device.as_mapping() | {"color": colors}
    out: dict[str, Any] = {"fringed_calibration": VERSION, "cameras": cameras}
    if calibration.projector is None:
        return out
    projector = calibration.projector.as_mapping()
    if calibration.response is not None:
        curves = dict(zip(("red", "green", "blue"), calibration.response.curves.tolist(), strict=True))
        projector["response"] = {"levels": calibration.response.levels.tolist()} | curves
    if calibration.registration is not None:
        projector["registration"] = calibration.registration.as_mapping()
    return out | {"projector": projector}


def _mapping(data: Mapping[str, Any], key: str, prefix: str) -> Mapping[str, Any]:
    value = data.get(key)
    if not isinstance(value, Mapping):
        raise CalibrationError(f"{prefix}{key} is missing or not a mapping")
    return value


def _numbers(data: Mapping[str, Any], key: str, name: str) -> Array:
    if key not in data:
        raise CalibrationError(f"{name}.{key} is missing")
    try:
        return np.array(data[key], dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise CalibrationError(f"{name}.{key} is not an array of numbers: {data[key]!r:.80}") from error


def _device(data: Mapping[str, Any], name: str) -> CameraModel:
    size = _numbers(data, "size", name)
    if size.shape != (2,) or (size != np.rint(size)).any():
        raise CalibrationError(f"{name}.size must be [width, height] in whole pixels, got {data['size']!r:.80}")
    keys = ("matrix", "distortion", "rotation", "translation")
    values = {key: _numbers(data, key, name) for key in keys}
    return CameraModel(size=(int(size[0]), int(size[1])), name=name, **values)


def _color(data: Mapping[str, Any], name: str) -> ColorModel:
    if data.get("color") is None:
        return ColorModel()
    color = _mapping(data, "color", f"{name}.")
    black = _numbers(color, "black", f"{name}.color") if "black" in color else np.zeros(3)
    crosstalk = _numbers(color, "crosstalk", f"{name}.color") if "crosstalk" in color else np.eye(3)
    balance = _numbers(color, "balance", f"{name}.color") if "balance" in color else np.ones(3)
    lateral_chromatic = (
        None if color.get("lateral") is None else lateral_chromatic_of(color["lateral"], f"{name}.color.lateral")
    )
    return ColorModel(black, crosstalk, f"{name}.color", balance, lateral_chromatic)


def _response(data: Mapping[str, Any]) -> Response | None:
    if data.get("response") is None:
        return None
    response = _mapping(data, "response", "projector.")
    curves = [_numbers(response, key, "projector.response") for key in ("red", "green", "blue")]
    if len({curve.shape for curve in curves}) != 1:
        raise CalibrationError("projector.response: red, green and blue have different lengths")
    return Response(_numbers(response, "levels", "projector.response"), np.stack(curves))
