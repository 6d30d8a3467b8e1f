"""Check of a colour calibration: the phase of one colour fringe against that of its green channel in many steps.

The steps of one colour are free of crosstalk and of the other channels' response and offset, and many of them cancel
harmonics; the difference of the single shot is its systematic error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.color_planes import Images, Mask, eroded
from pipeline.calibrate.color.color_sequence import FringeSet, check_frames
from pipeline.calibrate.color.crosstalk import fringe_phasors
from pipeline.common.errors import ImageError, PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import Fringe
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.calibration import ColorModel

Array = NDArray[np.float64]

_BINS = 60
_LEAST_POINTS = 2000


@dataclass(frozen=True, slots=True)
class PhaseError:
    """Phase of a single shot less its reference, radians.

    Args:
        rms_rad: over the white area, noise of the images included.
        systematic_rad: rms of the error's mean at each phase of the fringe: which colour calibration removes.
        mean_rad: the constant part.
        second_rad, third_rad: amplitudes of its parts that go with twice and three times the phase: unequal channels
            and crosstalk cause the former, the response the latter.
        points: pixels used.
    """

    rms_rad: float
    systematic_rad: float
    mean_rad: float
    second_rad: float
    third_rad: float
    points: int


def check_sequence(pattern: ColorFringe, *, steps: int = 8) -> FrameSequence:
    """The colour fringe, then its reference: show it uncalibrated for "before", with the response for "after"."""
    return FrameSequence("color check", tuple(check_frames(pattern, steps=steps)))


def phase_error(
    images: Sequence[NDArray[np.uint8]],
    sequence: FrameSequence,
    *,
    color: ColorModel | None = None,
    encoding: str = "rgb8",
    area: Mask | None = None,
    angles: Array | None = None,
    side: str = "left",
) -> PhaseError:
    """Phase error of one camera's images of :func:`check_sequence`.

    Args:
        images: raw, in the order of the sequence.
        color: the calibrated model of the camera; None = an uncalibrated one.
        area: (H, W) white pixels; None = where the fringes are strong.
        angles: (3, H, W), :func:`pipeline.decode.chromatic_phase.channel_angles` of this camera's pixels; None = 0.
    """
    frames = sequence.frames
    fringes = [f for f in frames if isinstance(f, ColorFringe)]
    steps = [(i, f) for i, f in enumerate(frames) if isinstance(f, Fringe)]
    if len(images) != len(frames) or len(fringes) != 1 or len(steps) < 5:
        raise PatternError(
            f"{len(images)} images of {len(frames)} frames, {len(fringes)} of them a colour fringe and {len(steps)} "
            "steps of its reference; expected the frames of check_sequence()"
        )
    names = tuple(type(f).__name__ for f in frames)
    views = Images(side, images, encoding, names)
    reference = FringeSet(steps[0][1], tuple(i for i, _ in steps), tuple(f.shift for _, f in steps))
    return error_of(views, frames.index(fringes[0]), fringes[0], reference, color=color, area=area, angles=angles)


def error_of(
    images: Images, index: int, pattern: ColorFringe, reference: FringeSet, *, color: ColorModel | None,
    area: Mask | None = None, angles: Array | None = None,
) -> PhaseError:  # fmt: skip
    """Phase error of one frame of a sequence against the steps of another set of its frames."""
    color = ColorModel() if color is None else color
    truth = fringe_phasors(images, reference, (1,))[..., 0]
    size = np.abs(truth)
    if area is None:
        area = eroded(size > 0.5 * np.percentile(size, 98), 2)
    if np.count_nonzero(area) < _LEAST_POINTS:
        raise ImageError(
            f"{images.side} camera: fringes are detected on {np.count_nonzero(area)} pixels only, at least "
            f"{_LEAST_POINTS} are needed; put a white board into the projector's light"
        )
    levels = (images.planes(index)[area] - color.black) @ color.unmix.T
    delta = np.broadcast_to(np.array(pattern.shifts), levels.shape)
    if angles is not None:
        delta = delta + np.moveaxis(angles, 0, -1)[area]
    design = np.stack([np.ones_like(delta), np.cos(delta), -np.sin(delta)], axis=-1)
    solved = np.linalg.solve(design, levels[..., None])[..., 0]
    expected = np.angle(truth[area])
    error = np.angle((solved[:, 1] + 1j * solved[:, 2]) * np.exp(-1j * expected))
    parts = np.clip(((expected + np.pi) / (2 * np.pi) * _BINS).astype(int), 0, _BINS - 1)
    count = np.bincount(parts, minlength=_BINS)
    means = np.bincount(parts, error, _BINS) / np.maximum(count, 1)
    systematic = float(np.sqrt((means[parts] ** 2).mean()))
    harmonics = [2 * float(abs((error * np.exp(-1j * n * expected)).mean())) for n in (2, 3)]
    return PhaseError(
        float(np.sqrt((error**2).mean())), systematic, float(error.mean()), harmonics[0], harmonics[1], len(error)
    )
