"""Lateral chromatic aberration of the cameras and registration of the projector's colours, from single-colour fringes.

At a pixel the fringe of red has another phase than the fringe of green, in x and in y: red light is displaced by
t = -(J d + s) projector pixels, with d the displacement in the camera's image, J the derivative of the projector's
coordinates by the camera's and s the projector's own offset. d belongs to one camera, s to both; both are fitted
together by least squares. The images hardly separate a shift or a magnification common to both cameras from one of the
projector: priors divide such parts (a shift is the projector's, a magnification either's). The measurement needs only
their sum, which the images determine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.channel_offsets import Offsets
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.lateral_chromatic import ColorDisplacement, ColorOffset, LateralChromatic, Registration

Array = NDArray[np.float64]

SMALLEST_PX = 0.03
"""Displacements that stay below this all over the image are left out of a calibration."""
# Standard deviations of the priors: shift px, magnification, displacement by the cubic term at the corner px; projector
# shift px, stretch.
_PRIOR_SHIFT, _PRIOR_MAGNIFICATION, _PRIOR_CUBIC_PX, _PRIOR_OFFSET, _PRIOR_STRETCH = 0.02, 3e-4, 0.02, 3.0, 3e-4


@dataclass(frozen=True, slots=True, eq=False)
class LateralChromaticSolution:
    """Lateral chromatic aberration of the cameras, registration of the projector; None where too small to matter.

    ``before_px``, ``after_px``: rms displacement of red and blue against green over the board, in camera pixels, per
    camera, as measured and after the fit.
    """

    cameras: tuple[LateralChromatic | None, ...]
    registration: Registration | None
    before_px: tuple[float, ...]
    after_px: tuple[float, ...]


def fit_lateral_chromatic(
    views: Sequence[Sequence[Offsets]], cameras: Sequence[CameraModel], size: tuple[int, int]
) -> LateralChromaticSolution:
    """Both cameras' lateral chromatic aberration and the projector's registration from all views.

    Args:
        views: for each camera its views of the board; cameras: their models; size: of the projector.
    """
    solved = [_fit_color(views, cameras, size, color) for color in ("red", "blue")]
    n = len(cameras)
    before, after = [], []
    for i, seen in enumerate(views):
        raw = [_in_camera(o, t) for o in seen for t in (o.red, o.blue)]
        rest = [
            _in_camera(o, t - (_terms(o, i, cameras, size) @ s).reshape(-1, 2))
            for o in seen
            for t, s in zip((o.red, o.blue), solved, strict=True)
        ]
        before.append(_rms(np.concatenate(raw)))
        after.append(_rms(np.concatenate(rest)))
    if all(max(b * b - a * a, 0.0) < SMALLEST_PX**2 for b, a in zip(before, after, strict=True)):
        return LateralChromaticSolution((None,) * n, None, tuple(before), tuple(after))
    lateral_chromatic: list[LateralChromatic | None] = []
    for i, camera in enumerate(cameras):
        red, blue = (ColorDisplacement(s[4 * i : 4 * i + 2], float(s[4 * i + 2]), float(s[4 * i + 3])) for s in solved)
        model = LateralChromatic(red, blue)
        lateral_chromatic.append(model if np.abs(model.at(camera, _corners(camera.size))).max() > SMALLEST_PX else None)
    offsets = [ColorOffset(s[4 * n : 4 * n + 2], s[4 * n + 2 :].reshape(2, 2)) for s in solved]
    registration: Registration | None = Registration(*offsets)
    if registration is not None and np.abs(registration.at(size, _corners(size))).max() <= SMALLEST_PX:
        registration = None
    return LateralChromaticSolution(tuple(lateral_chromatic), registration, tuple(before), tuple(after))


def _corners(size: tuple[int, int]) -> Array:
    width, height = size
    return np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)


def _in_camera(offsets: Offsets, t: Array) -> Array:
    """Offsets in projector pixels as displacements in the camera's image, (n, 2)."""
    return np.asarray(np.linalg.solve(offsets.jacobian, t[..., None])[..., 0], np.float64)


def _rms(displacements: Array) -> float:
    return float(np.sqrt((displacements**2).sum(axis=1).mean()))


def _terms(offsets: Offsets, index: int, cameras: Sequence[CameraModel], size: tuple[int, int]) -> Array:
    """Derivatives of t by all parameters, (2 n, 4 cameras + 6), at one camera's blocks."""
    m = cameras[index].matrix
    away = offsets.pixels - np.array([m[0, 2], m[1, 2]])
    r2 = (away[:, 0] / m[0, 0]) ** 2 + (away[:, 1] / m[1, 1]) ** 2
    n = len(away)
    own = np.zeros((n, 2, 4))
    own[:, 0, 0] = own[:, 1, 1] = 1
    own[:, :, 2], own[:, :, 3] = away, away * r2[:, None]
    out = np.zeros((n, 2, 4 * len(cameras) + 6))
    out[:, :, 4 * index : 4 * index + 4] = offsets.jacobian @ own
    p = offsets.projector - (np.array(size, np.float64) - 1) / 2
    at = 4 * len(cameras)
    out[:, 0, at] = out[:, 1, at + 1] = 1
    out[:, 0, at + 2 : at + 4] = out[:, 1, at + 4 : at + 6] = p
    return np.asarray(-out.reshape(2 * n, -1))


def _fit_color(
    views: Sequence[Sequence[Offsets]], cameras: Sequence[CameraModel], size: tuple[int, int], color: str
) -> Array:
    """Parameters of one colour, (4 cameras + 6,): robust least squares with priors."""
    terms = np.concatenate([_terms(o, i, cameras, size) for i, seen in enumerate(views) for o in seen])
    values = np.concatenate([getattr(o, color).ravel() for seen in views for o in seen])
    size_of = np.concatenate([np.repeat(o.weights, 2) for seen in views for o in seen])
    relative = np.sqrt(size_of / size_of.max())
    priors = []
    for camera in cameras:
        m = camera.matrix
        half = np.array(camera.size) / 2
        corner = float(np.hypot(*half)) * float((half[0] / m[0, 0]) ** 2 + (half[1] / m[1, 1]) ** 2)
        priors += [_PRIOR_SHIFT, _PRIOR_SHIFT, _PRIOR_MAGNIFICATION, _PRIOR_CUBIC_PX / corner]
    priors += [_PRIOR_OFFSET] * 2 + [_PRIOR_STRETCH] * 4
    scale = np.array(priors)
    sigma = 0.02
    robust: Array = np.ones(len(values))
    solution: Array = np.zeros(len(scale))
    for _ in range(8):
        weight = relative * np.sqrt(robust) / sigma
        system = np.concatenate([terms * scale * weight[:, None], np.eye(len(scale))])
        solution = (
            scale * np.linalg.lstsq(system, np.concatenate([values * weight, np.zeros(len(scale))]), rcond=None)[0]
        )
        residual = relative * (values - terms @ solution)
        sigma = max(1.4826 * float(np.median(np.abs(residual))), 1e-5)
        robust = np.minimum(1.0, 2 * sigma / np.maximum(np.abs(residual), 1e-12))
    return solution
