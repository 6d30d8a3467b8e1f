"""Absolute phase of a scene at rest from the images of a sequence, in any encoding.

Every pixel is solved independently (see :mod:`pipeline.multi_frame.n_step`): a Bayer mosaic needs no demosaicing where
fringes are grey. In a three-chip image the channels are added up first: crosstalk only moves light between channels,
so that the sum keeps it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import ImageError, PatternError
from pipeline.decode.noise_model import NoiseModel
from pipeline.decode.raw_image import BAYER
from pipeline.multi_frame.n_step import F64, Bools, WrappedPhase, absolute_phase, noise_of, solution_of, wrapped_phase
from pipeline.pattern.projected_frames import CHANNELS, Axis, Fringe
from pipeline.pattern.sequence import FrameSequence

_SATURATION = 254.0
_TURN = 2 * np.pi
_AXES: tuple[Axis, ...] = ("x", "y")


@dataclass(frozen=True, slots=True, eq=False)
class Coordinate:
    """Projector coordinate of a camera's pixels along one axis; all (H, W).

    Args:
        px: projector column (axis x) or row (axis y), NaN where unknown.
        sigma_px: one standard deviation from the images' noise, NaN likewise.
        amplitude, mean: of the finest fringe, counts of an 8-bit image, everywhere.
        saturated: some sample of the finest fringe is saturated.
    """

    px: F64
    sigma_px: F64
    amplitude: F64
    mean: F64
    saturated: Bools

    @property
    def valid(self) -> Bools:
        """Where the coordinate is valid."""
        return np.asarray(np.isfinite(self.px))


@dataclass(frozen=True, slots=True)
class Level:
    """Frames of a sequence that show one fringe with different shifts: their numbers and shifts, radians."""

    periods: float
    length: int
    frames: tuple[int, ...]
    shifts: tuple[float, ...]


def levels(sequence: FrameSequence, axis: Axis, *, lit: tuple[str, ...] = CHANNELS) -> tuple[Level, ...]:
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


def gray(image: NDArray[Any], encoding: str, *, channels: tuple[int, ...] = (0, 1, 2)) -> tuple[F64, Bools]:
    """Counts of an 8-bit image, (H, W), and where a sample is saturated.

    Args:
        image: raw, (H, W, 3) uint8 for rgb8, (H, W) uint8 for a mosaic or mono8, (H, W) uint16 for mono16.
        channels: of a three-chip image whose mean is taken; a mosaic's pixels each have one of their own.
    """
    known = {"rgb8": (3, np.uint8), "mono8": (2, np.uint8), "mono16": (2, np.uint16)} | dict.fromkeys(
        BAYER, (2, np.uint8)
    )
    if encoding not in known:
        raise ImageError(f"encoding {encoding!r:.80} is not known; expected one of {', '.join(known)}")
    dimensions, kind = known[encoding]
    if image.ndim != dimensions or image.dtype != kind or (dimensions == 3 and image.shape[2] != 3):
        raise ImageError(
            f"the image is {image.dtype} {image.shape}, but {encoding} is {np.dtype(kind)} with {dimensions} axes"
        )
    if encoding == "mono16":
        plane = image / 257.0
    elif encoding == "rgb8":
        # Plane by plane: sums along an axis of three are several times slower.
        planes = [image[..., c] for c in channels]
        total, saturated = planes[0].astype(np.uint16), planes[0] >= _SATURATION
        for one in planes[1:]:
            total += one
            saturated |= one >= _SATURATION
        return total / float(len(planes)), np.asarray(saturated)
    else:
        plane = image.astype(np.float64)
    return plane, np.asarray(plane >= _SATURATION)


def coordinates(
    images: Sequence[NDArray[Any]],
    sequence: FrameSequence,
    *,
    encoding: str = "rgb8",
    channels: tuple[int, ...] = (0, 1, 2),
    lit: tuple[str, ...] = CHANNELS,
    noise: NoiseModel | None = None,
    min_amplitude: float = 5.0,
    certainty: float = 3.0,
    axes: tuple[Axis, ...] = _AXES,
) -> tuple[Coordinate, ...]:
    """Projector column and row of every pixel, from one camera's images of a sequence.

    Args:
        images: raw, one for each frame of the sequence.
        channels: of the camera; lit: of the projector; see :func:`gray` and :func:`levels`.
        noise: of a sample as :func:`gray` gives it; None = estimated from the images (:func:`noise_of`).
        min_amplitude, certainty: see :func:`absolute_phase`.
        axes: ``x`` for columns, ``y`` for rows; one result each.

    Raises:
        PatternError: the sequence has no fringes for this; ImageError: an image does not fit.
    """
    if len(images) != len(sequence):
        raise ImageError(f"{len(images)} images of a sequence of {len(sequence)} frames; expected one each")
    found = {axis: levels(sequence, axis, lit=lit) for axis in axes}
    for axis, ones in found.items():
        if not ones:
            raise PatternError(
                f"sequence {sequence.name!r} has no three shifts of a fringe along {axis} in {', '.join(lit)}"
            )
    sets = {axis: [_set(images, one, encoding, channels) for one in ones] for axis, ones in found.items()}
    if noise is None:
        noise = noise_of([one for ones in sets.values() for one in ones])
    return tuple(
        _coordinate(sets[axis], found[axis], noise, min_amplitude=min_amplitude, certainty=certainty) for axis in axes
    )


def coordinate(images: Sequence[NDArray[Any]], sequence: FrameSequence, axis: Axis, **options: Any) -> Coordinate:
    """One of :func:`coordinates`."""
    return coordinates(images, sequence, axes=(axis,), **options)[0]


def evenly_lit(
    images: Sequence[NDArray[Any]], sequence: FrameSequence, *, lit: tuple[str, ...] = CHANNELS
) -> NDArray[np.float32]:
    """The scene without fringes, in the raw images' own layout and counts, float32.

    The mean of the finest fringes of both axes: as good as a white image of so many exposures, so marks are
    localised better here than in one white image. Where a sample of the images is saturated it is too dark.
    """
    finest = [found[-1] for axis in _AXES if (found := levels(sequence, axis, lit=lit))]
    if not finest or len(images) != len(sequence):
        raise ImageError(f"{len(images)} images of sequence {sequence.name!r}: they give no evenly lit image")
    total = np.zeros(images[finest[0].frames[0]].shape, np.float32)
    for level in finest:
        for number, share in zip(level.frames, solution_of(np.array(level.shifts))[0], strict=True):
            total += np.float32(share / len(finest)) * images[number]
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
    return Coordinate(px, sigma, finest.amplitude, finest.mean, finest.saturated)


def _set(images: Sequence[NDArray[Any]], level: Level, encoding: str, channels: tuple[int, ...]) -> WrappedPhase:
    shape = images[level.frames[0]].shape
    for number in level.frames:
        if images[number].shape != shape:
            raise ImageError(f"image {number} is {images[number].shape}, but others are {shape}")
    planes = [gray(images[number], encoding, channels=channels) for number in level.frames]
    return wrapped_phase([plane for plane, _ in planes], level.shifts, [saturated for _, saturated in planes])
