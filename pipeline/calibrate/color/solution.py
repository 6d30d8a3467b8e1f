"""Colour calibration from the images of a colour sequence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.color.channel_offsets import Offsets, measure_offsets
from pipeline.calibrate.color.color_planes import Images, View, view_of
from pipeline.calibrate.color.color_sequence import Roles, roles_of
from pipeline.calibrate.color.crosstalk import (
    MixSamples,
    balance_of,
    black_level,
    crosstalk_of,
    mix_samples,
)
from pipeline.calibrate.color.lateral_chromatic_fit import LateralChromaticSolution, fit_lateral_chromatic
from pipeline.calibrate.color.phase_error import error_of
from pipeline.calibrate.color.session_quality import (
    additivity_of,
    disagreement_of,
    exposure_recommendations,
    peak_of,
    projector_quality,
)
from pipeline.calibrate.color.tone_response import LevelCurve, level_curve, response_of
from pipeline.common.errors import ImageError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import Fringe, GrayBit, Uniform
from pipeline.pattern.sequence import Frame, FrameSequence
from pipeline.rig.calibration import Calibration, ColorModel, Response
from pipeline.rig.lateral_chromatic import Registration

Array = NDArray[np.float64]
Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]

SIDES = ("left", "right")


@dataclass(frozen=True, slots=True, eq=False)
class ColorSolution:
    """Colours of a rig.

    Args:
        left, right: black, crosstalk, balance and lateral chromatic aberration of the cameras.
        response: of the projector's channels, at all 256 levels.
        registration: of the projector's colours; None = not measured or too small to matter.
        white_balance: per camera, counts of each channel for its own full light on the white area, (3,).
        quality: figures and texts for the file's ``quality`` and for the report, see :func:`calibrate_color`.
        recommendations: plain sentences on what to change about exposure and gains; may be empty.
    """

    left: ColorModel
    right: ColorModel
    response: Response
    registration: Registration | None
    white_balance: dict[str, Array]
    quality: dict[str, Any]
    recommendations: tuple[str, ...]

    def applied(self, calibration: Calibration) -> Calibration:
        """The calibration with these colours; its geometry stays."""
        return replace(
            calibration, left_color=self.left, right_color=self.right, response=self.response,
            registration=self.registration,
        )  # fmt: skip


def calibrate_color(
    frames: Sequence[Pair],
    sequence: FrameSequence,
    *,
    encoding: str = "rgb8",
    calibration: Calibration | None = None,
    dark: Sequence[Pair] | None = None,
    shown: Response | None = None,
) -> ColorSolution:
    """Black, crosstalk, balance, response and lateral chromatic aberration from raw images of a white board.

    Args:
        frames: (left, right) of every frame of the sequence, in its order; several passes one after the other are
            averaged, and the board may be moved between them.
        sequence: what was shown, see :func:`pipeline.calibrate.color.color_sequence.color_sequence`.
        calibration: the rig's geometry, for lateral chromatic aberration, and the black levels known so far; None = no
            lateral colour.
        dark: images with the lenses covered, for the black level; without them it is estimated from dark marks on the
            board, taken from ``calibration``, or bounded by the darkest part of the view.
        shown: the response that the fringes were pre-distorted for; None = shown as they are.

    Returns:
        The solution; ``quality`` holds, per side, ``black_from``, ``crosstalk_sigma``, ``crosstalk_scatter``,
        ``white_share``, ``peak``, ``additivity``, ``lateral_before_px``, ``lateral_after_px``; for the projector
        ``response_sigma``, ``response_disagreement`` (of the cameras) and ``gamma``; ``lateral_problem`` if lateral
        colour could not be measured; and, when the sequence holds a check, ``phase_error_rad`` per side (uncorrected
        and with this solution, as the frames were shown).

    Raises:
        ImageError: clipped, dark or unfit images, with the camera, the frame and the remedy.
        PatternError: the sequence lacks something.
    """
    roles = roles_of(sequence)
    if not frames or len(frames) % len(sequence):
        raise ImageError(
            f"{len(frames)} pairs of images do not make whole passes of the sequence's {len(sequence)} frames; "
            "a frame is missing: take it again"
        )
    names = tuple(_name(frame) for frame in sequence.frames)
    passes = [frames[i : i + len(sequence)] for i in range(0, len(frames), len(sequence))]
    views = [
        [view_of(Images(side, [pair[i] for pair in one], encoding, names), roles) for one in passes]
        for i, side in enumerate(SIDES)
    ]
    curves: list[list[LevelCurve]] = [
        [level_curve(v.images, roles, k, v.black, v.full, v.area) for own in views for v in own] for k in range(3)
    ]
    response = response_of(curves)
    models, quality = [], projector_quality(response, curves)
    for i, side in enumerate(SIDES):
        known_black = None if calibration is None else (calibration.left_color, calibration.right_color)[i].black
        known_black = known_black if known_black is not None and known_black.any() else None  # zero: not measured
        covered = None if dark is None else [pair[i] for pair in dark]
        model, camera_quality = _camera(views[i], roles, response, covered, known_black, side)
        models.append(model)
        quality[side] = camera_quality
    registration: Registration | None = None
    recommendations = disagreement_of(curves, len(passes), quality)
    if calibration is not None and set(roles.single) == set(roles.coarse) == {"x", "y"}:
        try:
            lateral_chromatic = _lateral_chromatic(views, models, roles, calibration, response, shown)
        except ImageError as problem:
            # The other results do not depend on it.
            quality["lateral_problem"] = str(problem)
            recommendations.append(f"lateral chromatic aberration was not measured: {problem}")
        else:
            models = [
                replace(m, lateral_chromatic=one) for m, one in zip(models, lateral_chromatic.cameras, strict=True)
            ]
            registration = lateral_chromatic.registration
            for side, before, after in zip(SIDES, lateral_chromatic.before_px, lateral_chromatic.after_px, strict=True):
                quality[side] |= {"lateral_before_px": before, "lateral_after_px": after}
    _check(views, models, sequence, roles, quality)
    balance = {s: np.mean([v.full[v.area].mean(axis=0, dtype=np.float64) for v in own], axis=0)
               for s, own in zip(SIDES, views, strict=True)}  # fmt: skip
    for side in SIDES:
        recommendations += exposure_recommendations(side, balance[side], quality[side]["peak"])
    return ColorSolution(models[0], models[1], response, registration, balance, quality, tuple(recommendations))


def _camera(
    views: Sequence[View], roles: Roles, response: Response, dark: Sequence[NDArray[np.uint8]] | None,
    known: Array | None, side: str,
) -> tuple[ColorModel, dict[str, Any]]:  # fmt: skip
    """Colour model of one camera without lateral chromatic aberration, and its quality."""
    samples: list[MixSamples] = [mix_samples(v.images, list(roles.single.values()), v.area) for v in views]
    crosstalk, sigma, scatter = crosstalk_of(samples, side)
    blacks = [black_level(v.images, roles, v.black, v.full, v.area, dark=dark, known=known) for v in views]
    black = np.mean([level for level, _ in blacks], axis=0)
    balance = np.mean([balance_of(v.full, v.area) for v in views], axis=0)
    off = ~np.eye(3, dtype=bool)
    quality: dict[str, Any] = {
        "black_from": blacks[0][1],
        "crosstalk_sigma": float(sigma[off].max()),
        "crosstalk_scatter": float(scatter[off].max()),
        "white_share": float(np.mean([v.area.mean() for v in views])),
        "peak": max(peak_of(v, crosstalk) for v in views),
    }
    sums = [additivity_of(v, roles, response, crosstalk) for v in views]
    if all(s is not None for s in sums):
        quality["additivity"] = float(np.mean([s for s in sums if s is not None]))
    return ColorModel(black, crosstalk, f"cameras.{side}.color", balance), quality


def _lateral_chromatic(
    views: Sequence[Sequence[View]], models: Sequence[ColorModel], roles: Roles, calibration: Calibration,
    response: Response, shown: Response | None,
) -> LateralChromaticSolution:  # fmt: skip
    seen: list[list[Offsets]] = [
        [
            measure_offsets(
                v.images, roles, v.area, black=v.black, full=v.full, crosstalk=model.crosstalk,
                response=response, shown=shown,
            )
            for v in one
        ]
        for one, model in zip(views, models, strict=True)
    ]  # fmt: skip
    return fit_lateral_chromatic(seen, (calibration.left, calibration.right), calibration.projector.size)


def _check(
    views: Sequence[Sequence[View]], models: Sequence[ColorModel], sequence: FrameSequence, roles: Roles,
    quality: dict[str, Any],
) -> None:  # fmt: skip
    """Phase errors of the colour fringes in the sequence, before and after, into ``quality``."""
    for index, reference in roles.check_fringes[:1]:
        pattern = sequence.frames[index]
        if not isinstance(pattern, ColorFringe):
            continue
        for side, seen, model in zip(SIDES, views, models, strict=True):
            both = [error_of(seen[0].images, index, pattern, reference, color=c, area=seen[0].area)
                    for c in (None, model)]  # fmt: skip
            quality[side]["phase_error_rad"] = [e.rms_rad for e in both]


def _name(frame: Frame) -> str:
    if isinstance(frame, Uniform):
        return "even light " + " ".join(str(level) for level in frame.color)
    if isinstance(frame, Fringe):
        return f"fringe of {' '.join(frame.channels)} along {frame.axis}, shift {np.degrees(frame.shift):.0f} degrees"
    if isinstance(frame, GrayBit):
        return f"bit {frame.bit} of {frame.bits} of a Gray code along {frame.axis}"
    return f"colour fringe of {frame.periods:g} periods along {frame.axis}"
