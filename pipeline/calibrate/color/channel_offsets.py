"""Offsets of red and blue light against green on a flat board, in projector pixels, from fringes of single colours.

The difference of two colours' phases at a pixel needs no unwrapping. The projector coordinate and its slopes need the
absolute phase of green: one period of the colour fringe gives the order, the fine fringe the fraction.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_planes import F32, Images, Mask, blocks
from pipeline.calibrate.color.color_sequence import Axis, Roles
from pipeline.calibrate.color.crosstalk import fringe_phasors
from pipeline.common.errors import ImageError
from pipeline.rig.calibration import Response

Array = NDArray[np.float64]

_AXES: tuple[Axis, Axis] = ("x", "y")
_SIDE = 12  # of the blocks, pixels
_LEAST_BLOCKS = 30


@dataclass(frozen=True, slots=True, eq=False)
class Offsets:
    """Offsets of red and blue light against green in one camera's images, at n blocks of the board.

    Args:
        pixels: (n, 2) in the camera's image; projector: (n, 2) coordinates of the green light there.
        jacobian: (n, 2, 2), derivative of the projector's coordinates by the pixel's.
        red, blue: (n, 2), offset against green, projector pixels.
        weights: (n,) number of white pixels.
    """

    pixels: Array
    projector: Array
    jacobian: Array
    red: Array
    blue: Array
    weights: Array


def measure_offsets(
    images: Images, roles: Roles, area: Mask, *, black: F32, full: F32, crosstalk: Array,
    response: Response, shown: Response | None,
) -> Offsets:  # fmt: skip
    """Offsets of red and blue in one camera.

    Args:
        area, black, full: as in :func:`pipeline.calibrate.color.tone_response.level_curve`.
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
    if np.count_nonzero(used) < _LEAST_BLOCKS:
        raise ImageError(
            f"{images.side} camera: only {np.count_nonzero(used)} blocks of {_SIDE} x {_SIDE} pixels are evenly "
            f"white, at least {_LEAST_BLOCKS} are needed for lateral chromatic aberration; fill the image "
            "with a white board"
        )
    pixels = np.stack([sum_u[used], sum_v[used]], axis=1) / weights[used, None]
    for axis in _AXES:
        fringe = roles.single[axis][1].frame
        period = fringe.length / fringe.periods
        light = [fringe_phasors(images, s, (k,))[..., 0] for k, s in enumerate(roles.single[axis])]
        inside = area.astype(np.float32)
        for k, out in ((0, red), (2, blue)):
            turned = blocks(inside, light[k] * light[1].conj(), side=_SIDE)[1][used]
            out.append(np.angle(turned) * period / (2 * np.pi))
        relative = _relative_light(images.planes(roles.coarse[axis]) - black, full, crosstalk)
        coarse = _coarse_coordinate(relative, response if shown is None else None, fringe.length)
        value, slope = _smooth_coordinate(coarse, np.angle(light[1]), period, area, pixels, images.side)
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

    A fringe that was not pre-distorted is sinusoidal in drive values, which the inverse response restores.
    """
    wave = 255 * relative if response is None else response.drive(255 * relative)
    r, g, b = wave[..., 0], wave[..., 1], wave[..., 2]
    phase = np.arctan2(np.sqrt(3) * (r - b), 2 * g - r - b)
    return np.asarray(np.mod(phase, 2 * np.pi) * length / (2 * np.pi) - 0.5)


def _smooth_coordinate(
    coarse: Array, phase: NDArray[np.float32], period: float, area: Mask, pixels: Array, side: str
) -> tuple[Array, Array]:
    """The board's projector coordinate at some pixels, (n,), and its slopes, (n, 2).

    A polynomial of low degree through the coarse coordinate gives the order of the fine fringe, one of higher degree
    is fitted to the fine coordinate: a flat board in a lens of little distortion needs no more.
    """
    v, u = (index[::2] for index in np.nonzero(area))
    places = np.stack([u, v], axis=1)
    # Between -1 and 1 on the board: the normal equations of the fits are then well conditioned.
    low, high = places.min(axis=0), places.max(axis=0)
    middle, scale = (low + high) / 2, (high - low) / 2
    places = (places - middle) / scale
    rough = _fitted(_powers(places, 3), coarse[v, u])
    fine = (phase[v, u] / (2 * np.pi)) * period - 0.5
    absolute = fine + period * np.rint((rough - fine) / period)
    terms = _powers(places, 5)
    values = _coefficients(terms, absolute)
    residual = float(np.median(np.abs(absolute - terms @ values)))
    if residual > 0.1 * period:
        raise ImageError(
            f"{side} camera: the fringes do not lie on a flat board (typical deviation {residual:.1f} projector "
            f"pixels, limit {0.1 * period:.1f}); show one flat white board, and nothing else that is white"
        )
    at = (pixels - middle) / scale
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
    """Least squares without far outliers.

    Of the normal equations, which takes a third of the time that all rows do: with monomials up to degree 5 on [-1, 1]
    their condition number is some thousands, so that 11 digits are kept.
    """
    keep: Mask = np.ones(len(values), bool)
    solution: Array = np.zeros(terms.shape[1])
    for _ in range(4):
        used = terms[keep]
        solution = np.asarray(np.linalg.lstsq(used.T @ used, used.T @ values[keep], rcond=None)[0], np.float64)
        away = np.abs(values - terms @ solution)
        before, keep = keep, away <= max(4 * 1.4826 * float(np.median(away)), 1e-9)
        if np.array_equal(keep, before):
            break
    return solution


def _fitted(terms: Array, values: Array) -> Array:
    return np.asarray(terms @ _coefficients(terms, values))
