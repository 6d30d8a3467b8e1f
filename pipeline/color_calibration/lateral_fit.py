"""Lateral colour of both cameras and registration of the projector's colours, from fringes of one colour at a time.

At a pixel the fringe of red has another phase than the fringe of green, in x and in y: red light stands t = -(J d + s)
projector pixels beside its place, with d the displacement in the camera's picture, J the derivative of the projector's
coordinates by the camera's and s the projector's own offset. d belongs to one camera, s to both; both are fitted
together by least squares. The pictures hardly tell a shift or a magnification common to both cameras from one of the
projector: priors share such parts out (a shift is the projector's, a magnification anybody's). What the measuring needs
is their sum, and that is told by the pictures alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import Response
from pipeline.camera_model import CameraModel
from pipeline.color_calibration.crosstalk import fringe_phasors
from pipeline.color_calibration.frames import Axis, Roles
from pipeline.color_calibration.pictures import F32, Mask, Pictures, blocks
from pipeline.errors import PictureError
from pipeline.lateral import ColorDisplacement, ColorOffset, Lateral, Registration

Array = NDArray[np.float64]

THIRD = 2 * np.pi / 3
SMALLEST_PX = 0.03
"""Displacements that stay below this all over the picture are left out of a calibration."""
_AXES: tuple[Axis, Axis] = ("x", "y")
_SIDE = 12  # of the blocks, pixels
# Standard deviations of the priors: shift px, magnification, displacement by the cubic term at the corner px; projector
# shift px, stretch.
_PRIOR_SHIFT, _PRIOR_MAGNIFICATION, _PRIOR_CUBIC_PX, _PRIOR_OFFSET, _PRIOR_STRETCH = 0.02, 3e-4, 0.02, 3.0, 3e-4


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Where red and blue light stands against green in one camera's pictures, at n blocks of the board.

    Args:
        pixels: (n, 2) in the camera's picture; projector: (n, 2) coordinates of the green light there.
        jacobian: (n, 2, 2), derivative of the projector's coordinates by the pixel's.
        red, blue: (n, 2), t of the module's text, projector pixels.
        weights: (n,) number of white pixels.
    """

    pixels: Array
    projector: Array
    jacobian: Array
    red: Array
    blue: Array
    weights: Array


def measure_offsets(
    pictures: Pictures, roles: Roles, area: Mask, *, black: F32, full: F32, crosstalk: Array,
    response: Response, shown: Response | None,
) -> Offsets:  # fmt: skip
    """Offsets of red and blue seen by one camera.

    Args:
        area, black, full: as in :func:`pipeline.color_calibration.response.level_curve`.
        crosstalk: (3, 3) of this camera; response: of the projector, as just measured.
        shown: the response that the fringes were pre-distorted for; None = they were shown as they are.
    """
    where: list[Array] = []
    slopes: list[Array] = []
    red: list[Array] = []
    blue: list[Array] = []
    v, u = np.mgrid[0 : area.shape[0], 0 : area.shape[1]].astype(np.float32)
    weights, sum_u, sum_v = blocks(area.astype(np.float32), u, v, side=_SIDE)
    used = weights > 0.4 * _SIDE**2
    if np.count_nonzero(used) < 30:
        raise PictureError(
            f"{pictures.side} camera: only {np.count_nonzero(used)} blocks of {_SIDE} x {_SIDE} pixels are evenly "
            "white, at least 30 are needed for lateral colour; fill the picture with a white board"
        )
    pixels = np.stack([sum_u[used], sum_v[used]], axis=1) / weights[used, None]
    for axis in _AXES:
        fringe = roles.single[axis][1].frame
        period = fringe.length / fringe.periods
        light = [fringe_phasors(pictures, s, (k,))[..., 0] for k, s in enumerate(roles.single[axis])]
        inside = area.astype(np.float32)
        for k, out in ((0, red), (2, blue)):
            turned = blocks(inside, light[k] * light[1].conj(), side=_SIDE)[1][used]
            out.append(np.angle(turned) * period / (2 * np.pi))
        relative = _relative_light(pictures.planes(roles.coarse[axis]) - black, full, crosstalk)
        coarse = _coarse_coordinate(relative, response if shown is None else None, fringe.length)
        value, slope = _smooth_coordinate(coarse, np.angle(light[1]), period, area, pixels, pictures.side)
        where.append(value)
        slopes.append(slope)
    return Offsets(
        pixels, np.stack(where, axis=1), np.stack(slopes, axis=1), np.stack(red, axis=1), np.stack(blue, axis=1),
        weights[used],
    )  # fmt: skip


def _relative_light(counts: F32, full: F32, crosstalk: Array) -> Array:
    """Light of each projector channel as a share of its full one, (H, W, 3), from counts above the black frame."""
    own = counts @ np.linalg.inv(crosstalk).T.astype(np.float32)
    return np.asarray(np.clip(own / np.maximum(full, 1.0), 0.0, 1.0), np.float64)


def _coarse_coordinate(relative: Array, response: Response | None, length: int) -> Array:
    """Projector coordinate from one period of the colour fringe, (H, W), good to some pixels.

    A fringe that was not pre-distorted is sinusoidal in drive values, which the response gives back.
    """
    wave = 255 * relative if response is None else response.drive(255 * relative)
    r, g, b = wave[..., 0], wave[..., 1], wave[..., 2]
    phase = np.arctan2(np.sqrt(3) * (r - b), 2 * g - r - b)
    return np.asarray(np.mod(phase, 2 * np.pi) * length / (2 * np.pi) - 0.5)


def _smooth_coordinate(
    coarse: Array, phase: NDArray[np.float32], period: float, area: Mask, pixels: Array, side: str
) -> tuple[Array, Array]:
    """The board's projector coordinate at some pixels, (n,), and its slopes, (n, 2).

    A polynomial of low degree through the coarse coordinate tells the order of the fine fringe, one of higher degree
    goes through the fine coordinate: a flat board in a lens of little distortion needs no more.
    """
    v, u = (index[::2] for index in np.nonzero(area))
    scale = np.array(area.shape[::-1], np.float64) / 2
    places = (np.stack([u, v], axis=1) - scale) / scale
    rough = _fitted(_powers(places, 3), coarse[v, u])
    fine = (phase[v, u] / (2 * np.pi)) * period - 0.5
    absolute = fine + period * np.rint((rough - fine) / period)
    terms = _powers(places, 5)
    values = _coefficients(terms, absolute)
    residual = float(np.median(np.abs(absolute - terms @ values)))
    if residual > 0.1 * period:
        raise PictureError(
            f"{side} camera: the fringes do not lie on a flat board (typical deviation {residual:.1f} projector "
            f"pixels, limit {0.1 * period:.1f}); show one flat white board, and nothing else that is white"
        )
    at = (pixels - scale) / scale
    slopes = [_powers(at, 5, along) @ values / scale[along] for along in (0, 1)]
    return _powers(at, 5) @ values, np.stack(slopes, axis=1)


def _powers(places: Array, degree: int, along: int | None = None) -> Array:
    """Monomials x^i y^j up to a degree, or their derivatives by x (0) or y (1); (n, 2) -> (n, m)."""
    x, y = places[:, 0], places[:, 1]
    out = []
    for i in range(degree + 1):
        for j in range(degree + 1 - i):
            if along is None:
                out.append(x**i * y**j)
            elif along == 0:
                out.append(i * x ** max(i - 1, 0) * y**j)
            else:
                out.append(j * x**i * y ** max(j - 1, 0))
    return np.stack(out, axis=1)


def _coefficients(terms: Array, values: Array) -> Array:
    """Least squares without far outliers."""
    keep: Mask = np.ones(len(values), bool)
    solution: Array = np.zeros(terms.shape[1])
    for _ in range(4):
        solution = np.linalg.lstsq(terms[keep], values[keep], rcond=None)[0]
        away = np.abs(values - terms @ solution)
        keep = away <= max(4 * 1.4826 * float(np.median(away)), 1e-9)
    return solution


def _fitted(terms: Array, values: Array) -> Array:
    return np.asarray(terms @ _coefficients(terms, values))


@dataclass(frozen=True, slots=True, eq=False)
class LateralSolution:
    """Lateral colour of the cameras, registration of the projector; None where too small to matter.

    ``before_px``, ``after_px``: rms displacement of red and blue against green over the board, in camera pixels, per
    camera, as measured and after the fit.
    """

    cameras: tuple[Lateral | None, ...]
    registration: Registration | None
    before_px: tuple[float, ...]
    after_px: tuple[float, ...]


def fit_lateral(
    views: Sequence[Sequence[Offsets]], cameras: Sequence[CameraModel], size: tuple[int, int]
) -> LateralSolution:
    """Both cameras' lateral colour and the projector's registration from all views.

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
        return LateralSolution((None,) * n, None, tuple(before), tuple(after))
    lateral: list[Lateral | None] = []
    for i, camera in enumerate(cameras):
        red, blue = (ColorDisplacement(s[4 * i : 4 * i + 2], float(s[4 * i + 2]), float(s[4 * i + 3])) for s in solved)
        model = Lateral(red, blue)
        lateral.append(model if np.abs(model.at(camera, _corners(camera.size))).max() > SMALLEST_PX else None)
    offsets = [ColorOffset(s[4 * n : 4 * n + 2], s[4 * n + 2 :].reshape(2, 2)) for s in solved]
    registration: Registration | None = Registration(*offsets)
    if registration is not None and np.abs(registration.at(size, _corners(size))).max() <= SMALLEST_PX:
        registration = None
    return LateralSolution(tuple(lateral), registration, tuple(before), tuple(after))


def _corners(size: tuple[int, int]) -> Array:
    width, height = size
    return np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], np.float64)


def _in_camera(offsets: Offsets, t: Array) -> Array:
    """Offsets in projector pixels as displacements in the camera's picture, (n, 2)."""
    return np.linalg.solve(offsets.jacobian, t[..., None])[..., 0]


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
