"""Absolute phase of a scene at rest from several fringe pictures: N-step phase, then temporal unwrapping.

Sample n of a pixel is ``I_n = A + B cos(Phi + s_n)`` with known shifts s_n: linear in ``A, C = B cos(Phi), S = B
sin(Phi)``, so least squares over any three or more shifts solve it (Bruning et al., Appl. Opt. 13, 2693, 1974). The
finest fringe gives the phase; a coarser one says in which of its periods a pixel lies (Huntley and Saldner, Appl. Opt.
32, 3047, 1993), level by level down to a fringe of at most one period, which needs no help.

Every pixel is solved by itself: a Bayer mosaic needs no demosaicing where fringes are grey. In a three-chip picture the
channels are added up first: what crosstalk takes from one channel it gives to another, and grey stays grey.
"""

from __future__ import annotations

from collections.abc import Sequence as Items
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import PatternError, PictureError
from pipeline.noise import NoiseModel
from pipeline.raw import BAYER
from pipeline.sequence import CHANNELS, Axis, Fringe, Sequence

F64: TypeAlias = NDArray[np.float64]
Bools: TypeAlias = NDArray[np.bool_]

_SATURATION = 254.0
_TURN = 2 * np.pi
_AXES: tuple[Axis, ...] = ("x", "y")
_WORST_CONDITION = 50.0
_FEWEST_PIXELS = 200


@dataclass(frozen=True, slots=True, eq=False)
class WrappedPhase:
    """Phase of one set of shifted fringes, all (H, W).

    Args:
        phase: radians, -pi..pi; any value where the amplitude is 0.
        amplitude: B, counts of an 8-bit picture; mean: A, likewise.
        clipped: a sample is saturated; phase and amplitude are then wrong.
        floor_factor, shot_factor: the variance of the phase is ``floor * floor_factor + gain * shot_factor`` for a
            noise of ``floor + gain * counts``.
        steps: number of pictures.
    """

    phase: F64
    amplitude: F64
    mean: F64
    clipped: Bools
    floor_factor: F64
    shot_factor: F64
    steps: int

    def sigma(self, noise: NoiseModel) -> F64:
        """Standard deviation of the phase from the pictures' noise, (H, W), radians."""
        return np.asarray(np.sqrt(noise.floor * self.floor_factor + noise.gain * np.maximum(self.shot_factor, 0)))


@dataclass(frozen=True, slots=True, eq=False)
class Coordinate:
    """Where on the projector's picture a camera's pixels are lit from, along one axis; all (H, W).

    Args:
        px: projector column (axis x) or row (axis y), NaN where unknown.
        sigma_px: one standard deviation from the pictures' noise, NaN likewise.
        amplitude, mean: of the finest fringe, counts of an 8-bit picture, everywhere.
        clipped: some sample of the finest fringe is saturated.
    """

    px: F64
    sigma_px: F64
    amplitude: F64
    mean: F64
    clipped: Bools

    @property
    def good(self) -> Bools:
        """Where the coordinate is known."""
        return np.asarray(np.isfinite(self.px))


@dataclass(frozen=True, slots=True)
class Level:
    """Frames of a sequence that show one fringe with different shifts: their numbers and shifts, radians."""

    periods: float
    length: int
    frames: tuple[int, ...]
    shifts: tuple[float, ...]


def levels(sequence: Sequence, axis: Axis, *, lit: tuple[str, ...] = CHANNELS) -> tuple[Level, ...]:
    """The sets of shifted fringes along an axis that are lit in just these channels, coarsest first.

    Sets of less than three shifts are left out.
    """
    found: dict[tuple[float, float, float], list[int]] = {}
    for number, frame in enumerate(sequence.frames):
        if isinstance(frame, Fringe) and frame.axis == axis and frame.channels == lit:
            found.setdefault((frame.periods, frame.mean, frame.amplitude), []).append(number)
    out = []
    for (periods, _, _), numbers in sorted(found.items()):
        shown = [sequence.frames[n] for n in numbers]
        shifts = tuple(frame.shift for frame in shown if isinstance(frame, Fringe))
        if len(shifts) >= 3:
            out.append(Level(periods, sequence.size[0 if axis == "x" else 1], tuple(numbers), shifts))
    return tuple(out)


def gray(picture: NDArray[Any], encoding: str, *, channels: tuple[int, ...] = (0, 1, 2)) -> tuple[F64, Bools]:
    """Counts of an 8-bit picture, (H, W), and where a sample is saturated.

    Args:
        picture: raw, (H, W, 3) uint8 for rgb8, (H, W) uint8 for a mosaic or mono8, (H, W) uint16 for mono16.
        channels: of a three-chip picture whose mean is taken; a mosaic's pixels each have one of their own.
    """
    known = {"rgb8": (3, np.uint8), "mono8": (2, np.uint8), "mono16": (2, np.uint16)} | dict.fromkeys(
        BAYER, (2, np.uint8)
    )
    if encoding not in known:
        raise PictureError(f"encoding {encoding!r:.80} is not known; expected one of {', '.join(known)}")
    dimensions, kind = known[encoding]
    if picture.ndim != dimensions or picture.dtype != kind or (dimensions == 3 and picture.shape[2] != 3):
        raise PictureError(
            f"the picture is {picture.dtype} {picture.shape}, but {encoding} is {np.dtype(kind)} with {dimensions} axes"
        )
    if encoding == "mono16":
        plane = picture / 257.0
    elif encoding == "rgb8":
        # Plane by plane: sums along an axis of three are several times slower.
        planes = [picture[..., c] for c in channels]
        total, clipped = planes[0].astype(np.uint16), planes[0] >= _SATURATION
        for one in planes[1:]:
            total += one
            clipped |= one >= _SATURATION
        return total / float(len(planes)), np.asarray(clipped)
    else:
        plane = picture.astype(np.float64)
    return plane, np.asarray(plane >= _SATURATION)


def wrapped_phase(planes: Items[F64], shifts: Items[float], clipped: Items[Bools] = ()) -> WrappedPhase:
    """Least-squares phase of pictures (H, W) of one fringe with these shifts, radians.

    Args:
        planes: counts of the pictures, one for each shift; any iterable, each is read once.
        clipped: where each picture is saturated; empty = nowhere.

    Raises:
        PatternError: when three unknowns cannot be told apart by these shifts.
    """
    s = np.asarray(shifts, dtype=np.float64)
    solve = _solution_of(s)
    c, q = solve[1], solve[2]
    # Rows: A, C, S, and the sums that the variance of C, S from shot noise is made of.
    rows = np.stack([*solve, c * c, c * q, q * q])
    total: F64 | None = None
    for row, plane in zip(rows.T, planes, strict=True):
        if total is None:
            total = np.zeros((len(rows), *plane.shape))
        for k, weight in enumerate(row):
            total[k] += weight * plane
    assert total is not None  # noqa: S101 (there are at least three)
    mean, re, im, shot_cc, shot_cs, shot_ss = total
    square = re * re + im * im
    with np.errstate(divide="ignore", invalid="ignore"):
        # d phase = (C dS - S dC) / B^2
        floor = (re * re * (q @ q) - 2 * re * im * (c @ q) + im * im * (c @ c)) / square**2
        shot = (re * re * shot_ss - 2 * re * im * shot_cs + im * im * shot_cc) / square**2
    none = np.zeros(mean.shape, np.bool_)
    saturated = np.logical_or.reduce([none, *clipped])
    return WrappedPhase(np.arctan2(im, re), np.sqrt(square), mean, saturated, floor, shot, len(s))


def unwrapped(
    coarse: F64, coarse_sigma: F64, phase: F64, sigma: F64, ratio: float, *, certainty: float = 3.0, edge: bool = False
) -> F64:
    """Absolute phase of a fringe from that of a coarser one, NaN where its period is not certain.

    A pixel is taken when the coarser phase says the place within the period to less than half a period, and stays
    there when it is moved by ``certainty`` standard deviations of their difference.

    Args:
        coarse: absolute phase of the coarser fringe; phase: wrapped phase of the finer one; radians.
        coarse_sigma, sigma: their standard deviations.
        ratio: periods of the finer one per period of the coarser one.
        edge: the coarser fringe has just one period, and noise may have moved it from one end to the other.
    """
    best = np.full(phase.shape, np.nan)
    least = np.full(phase.shape, np.inf)
    for turn in (0.0, -1.0, 1.0) if edge else (0.0,):
        expected = ratio * (coarse + turn * _TURN)
        absolute = phase + _TURN * np.rint((expected - phase) / _TURN)
        away = np.abs(absolute - expected)
        if edge:
            away[(absolute < 0) | (absolute > ratio * _TURN)] = np.inf
        with np.errstate(invalid="ignore"):
            closer = away < least
        best[closer], least[closer] = absolute[closer], away[closer]
    with np.errstate(invalid="ignore"):
        sure = least + certainty * np.hypot(ratio * coarse_sigma, sigma) < np.pi
    best[~sure] = np.nan
    return best


def noise_of(sets: Items[WrappedPhase]) -> NoiseModel:
    """Noise of a sample, from two sets' means of the same scene: they differ by nothing else.

    The two with the most steps are compared, in groups of equal brightness; robust against some moving pixels. With
    fewer than two sets, or too few pixels, half a count (rounding, a quiet sensor) is taken.
    """
    best = sorted(sets, key=lambda one: -one.steps)[:2]
    if len(best) < 2:
        return NoiseModel(0.25, 0.0)
    a, b = best
    fine = ~(a.clipped | b.clipped)
    level, difference = (a.mean[fine] + b.mean[fine]) / 2, a.mean[fine] - b.mean[fine]
    if len(level) < _FEWEST_PIXELS:
        return NoiseModel(0.25, 0.0)
    order = np.argsort(level, kind="stable")
    groups = np.array_split(order, min(16, len(order) // 100))
    x = np.array([level[g].mean() for g in groups])
    y = np.array([_variance(difference[g]) for g in groups]) / (1 / a.steps + 1 / b.steps)
    design = np.stack([np.ones_like(x), x], axis=1) / y[:, None]
    floor, gain = np.linalg.lstsq(design, np.ones_like(y), rcond=None)[0]
    if gain < 0 or floor < 0:
        floor, gain = (float(y.mean()), 0.0) if gain < 0 else (0.0, float((y / x).mean()))
    return NoiseModel(float(floor), float(gain))


def _variance(values: F64) -> float:
    """Variance without the outliers; the values may be coarsely rounded, so that their median says little."""
    low, high = np.quantile(values, [0.05, 0.95])
    middle, reach = (low + high) / 2, (high - low) * (4 / 3.29)
    return max(float(values[np.abs(values - middle) <= reach].var()), 1e-6)


def absolute_phase(
    sets: Items[WrappedPhase],
    periods: Items[float],
    noise: NoiseModel,
    *,
    min_amplitude: float = 5.0,
    certainty: float = 3.0,
) -> F64:
    """Absolute phase of the finest of several fringes, (H, W), radians; NaN where unknown.

    Args:
        sets: coarsest first; periods: of each over the projector, rising, the first at most 1.
        min_amplitude: of every set, counts.
        certainty: see :func:`unwrapped`.
    """
    if not sets or len(sets) != len(periods):
        raise PatternError(f"{len(sets)} sets of fringes with {len(periods)} numbers of periods: expected the same")
    if periods[0] > 1:
        raise PatternError(
            f"the coarsest fringe has {periods[0]:g} periods: an absolute phase needs one with at most 1; add it"
        )
    # Half of what the wrapped phase leaves over lies below the first column, half beyond the last one.
    lowest = -np.pi * (1 - periods[0])
    sigma = sets[0].sigma(noise)
    absolute = np.mod(sets[0].phase - lowest, _TURN) + lowest
    known = (sets[0].amplitude >= min_amplitude) & ~sets[0].clipped
    for last, here, one in zip(periods, periods[1:], sets[1:], strict=False):
        finer = one.sigma(noise)
        absolute = unwrapped(
            absolute, sigma, one.phase, finer, here / last, certainty=certainty, edge=last == 1 and last == periods[0]
        )
        known &= (one.amplitude >= min_amplitude) & ~one.clipped
        sigma = finer
    if periods[0] == 1:
        # Here one end of the picture cannot be told from the other.
        near = certainty * sigma
        with np.errstate(invalid="ignore"):
            known &= (absolute > near) & (absolute < _TURN * periods[-1] - near)
    return np.where(known, absolute, np.nan)


def coordinates(
    pictures: Items[NDArray[Any]],
    sequence: Sequence,
    *,
    encoding: str = "rgb8",
    channels: tuple[int, ...] = (0, 1, 2),
    lit: tuple[str, ...] = CHANNELS,
    noise: NoiseModel | None = None,
    min_amplitude: float = 5.0,
    certainty: float = 3.0,
    axes: tuple[Axis, ...] = _AXES,
) -> tuple[Coordinate, ...]:
    """Projector column and row of every pixel, from one camera's pictures of a sequence.

    Args:
        pictures: raw, one for each frame of the sequence.
        channels: of the camera; lit: of the projector; see :func:`gray` and :func:`levels`.
        noise: of a sample as :func:`gray` gives it; None = estimated from the pictures (:func:`noise_of`).
        min_amplitude, certainty: see :func:`absolute_phase`.
        axes: ``x`` for columns, ``y`` for rows; one result each.

    Raises:
        PatternError: the sequence has no fringes for this; PictureError: a picture does not fit.
    """
    if len(pictures) != len(sequence):
        raise PictureError(f"{len(pictures)} pictures of a sequence of {len(sequence)} frames; expected one each")
    found = {axis: levels(sequence, axis, lit=lit) for axis in axes}
    for axis, ones in found.items():
        if not ones:
            raise PatternError(
                f"sequence {sequence.name!r} has no three shifts of a fringe along {axis} in {', '.join(lit)}"
            )
    sets = {axis: [_set(pictures, one, encoding, channels) for one in ones] for axis, ones in found.items()}
    if noise is None:
        noise = noise_of([one for ones in sets.values() for one in ones])
    return tuple(
        _coordinate(sets[axis], found[axis], noise, min_amplitude=min_amplitude, certainty=certainty) for axis in axes
    )


def coordinate(pictures: Items[NDArray[Any]], sequence: Sequence, axis: Axis, **options: Any) -> Coordinate:
    """One of :func:`coordinates`."""
    return coordinates(pictures, sequence, axes=(axis,), **options)[0]


def evenly_lit(
    pictures: Items[NDArray[Any]], sequence: Sequence, *, lit: tuple[str, ...] = CHANNELS
) -> NDArray[np.float32]:
    """The scene without fringes, in the raw pictures' own layout and counts, float32.

    The mean of the finest fringes of both axes: as good as a white picture of so many exposures, so marks are better
    found here than in one white picture. Where a sample of the pictures is saturated it is too dark.
    """
    finest = [found[-1] for axis in _AXES if (found := levels(sequence, axis, lit=lit))]
    if not finest or len(pictures) != len(sequence):
        raise PictureError(f"{len(pictures)} pictures of sequence {sequence.name!r}: no even light comes of them")
    total = np.zeros(pictures[finest[0].frames[0]].shape, np.float32)
    for level in finest:
        for number, share in zip(level.frames, _solution_of(np.array(level.shifts))[0], strict=True):
            total += np.float32(share / len(finest)) * pictures[number]
    return total


def _coordinate(
    sets: list[WrappedPhase], found: tuple[Level, ...], noise: NoiseModel, *, min_amplitude: float, certainty: float
) -> Coordinate:
    phase = absolute_phase(
        sets, [level.periods for level in found], noise, min_amplitude=min_amplitude, certainty=certainty
    )
    finest, per_radian = sets[-1], found[-1].length / (_TURN * found[-1].periods)
    px = phase * per_radian - 0.5
    with np.errstate(invalid="ignore"):
        px[(px < -0.5) | (px > found[-1].length - 0.5)] = np.nan
    sigma = np.where(np.isfinite(px), finest.sigma(noise) * per_radian, np.nan)
    return Coordinate(px, sigma, finest.amplitude, finest.mean, finest.clipped)


def _set(pictures: Items[NDArray[Any]], level: Level, encoding: str, channels: tuple[int, ...]) -> WrappedPhase:
    shape = pictures[level.frames[0]].shape
    for number in level.frames:
        if pictures[number].shape != shape:
            raise PictureError(f"picture {number} is {pictures[number].shape}, but others are {shape}")
    planes = [gray(pictures[number], encoding, channels=channels) for number in level.frames]
    return wrapped_phase([plane for plane, _ in planes], level.shifts, [clipped for _, clipped in planes])


def _solution_of(shifts: F64) -> F64:
    """(3, n): samples -> A, C, S."""
    if len(shifts) < 3:
        raise PatternError(f"{len(shifts)} shifted fringes: expected at least 3")
    design = np.stack([np.ones_like(shifts), np.cos(shifts), -np.sin(shifts)], axis=1)
    if np.linalg.cond(design) > _WORST_CONDITION:
        raise PatternError(f"shifts {np.round(shifts, 3).tolist()!s:.80} do not tell phase, amplitude and mean apart")
    return np.asarray(np.linalg.pinv(design))
