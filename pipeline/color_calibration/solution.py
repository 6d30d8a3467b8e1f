"""From the pictures of a colour sequence to everything that a calibration file says about colour."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.calibration import Calibration, ColorModel, Response
from pipeline.color_calibration.check import error_of
from pipeline.color_calibration.crosstalk import (
    MixSamples,
    balance_of,
    black_level,
    crosstalk_of,
    mix_samples,
)
from pipeline.color_calibration.frames import Roles, roles_of
from pipeline.color_calibration.lateral_fit import LateralSolution, Offsets, fit_lateral, measure_offsets
from pipeline.color_calibration.pictures import F32, Mask, Pictures, white_area
from pipeline.color_calibration.response import LevelCurve, level_curve, response_of
from pipeline.errors import PictureError
from pipeline.lateral import Registration
from pipeline.pattern import ColorFringe
from pipeline.sequence import CHANNELS, Fringe, Uniform
from pipeline.sequence import Sequence as Frames

Array = NDArray[np.float64]
Pair = tuple[NDArray[np.uint8], NDArray[np.uint8]]

SIDES = ("left", "right")
GOOD_PEAK = (180.0, 245.0)
UNEVEN_BALANCE = 1.25


@dataclass(frozen=True, slots=True, eq=False)
class ColorSolution:
    """Colours of a rig.

    Args:
        left, right: black, crosstalk, balance and lateral colour of the cameras.
        response: of the projector's channels, at all 256 levels.
        registration: of the projector's colours; None = not measured or too small to matter.
        white_balance: per camera, counts of each channel for its own full light on the white area, (3,).
        quality: numbers and words for the file's ``quality`` and for the report, see :func:`calibrate_color`.
        advice: plain sentences on what to change about exposure and gains; may be empty.
    """

    left: ColorModel
    right: ColorModel
    response: Response
    registration: Registration | None
    white_balance: dict[str, Array]
    quality: dict[str, Any]
    advice: tuple[str, ...]

    def applied(self, calibration: Calibration) -> Calibration:
        """The calibration with these colours; its geometry stays."""
        return replace(
            calibration, left_color=self.left, right_color=self.right, response=self.response,
            registration=self.registration,
        )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class _View:
    """One camera's pictures of one pass, and what does not change while they are evaluated."""

    pictures: Pictures
    black: F32
    full: F32
    area: Mask


def calibrate_color(
    frames: Sequence[Pair],
    sequence: Frames,
    *,
    encoding: str = "rgb8",
    calibration: Calibration | None = None,
    dark: Sequence[Pair] | None = None,
    shown: Response | None = None,
) -> ColorSolution:
    """Black, crosstalk, balance, response and lateral colour from raw pictures of a white board.

    Args:
        frames: (left, right) of every frame of the sequence, in its order; several passes one after the other are
            averaged, and the board may be moved between them.
        sequence: what was shown, see :func:`pipeline.color_calibration.frames.color_sequence`.
        calibration: the rig's geometry, for lateral colour, and the black levels known so far; None = no lateral
            colour.
        dark: pictures with the lenses covered, for the black level; without them it is told from dark marks on the
            board, taken from ``calibration``, or bounded by the darkest part of the view.
        shown: the response that the fringes were pre-distorted for; None = shown as they are.

    Returns:
        The solution; ``quality`` holds, per side, ``black_from``, ``crosstalk_sigma``, ``crosstalk_scatter``,
        ``white_share``, ``peak``, ``additivity``, ``lateral_before_px``, ``lateral_after_px``; for the projector
        ``response_sigma`` and ``gamma``; and, when the sequence holds a check, ``phase_error_rad`` per side
        (uncorrected and with this solution, as the frames were shown).

    Raises:
        PictureError: clipped, dark or unfit pictures, with the camera, the frame and the remedy.
        PatternError: the sequence lacks something.
    """
    roles = roles_of(sequence)
    if not frames or len(frames) % len(sequence):
        raise PictureError(
            f"{len(frames)} pairs of pictures do not make whole passes of the sequence's {len(sequence)} frames; "
            "a frame is missing: take it again"
        )
    names = tuple(_name(frame) for frame in sequence.frames)
    passes = [frames[i : i + len(sequence)] for i in range(0, len(frames), len(sequence))]
    views = [
        [_view(Pictures(side, [pair[i] for pair in once], encoding, names), roles) for once in passes]
        for i, side in enumerate(SIDES)
    ]
    curves: list[list[LevelCurve]] = [
        [level_curve(v.pictures, roles, k, v.black, v.full, v.area) for seen in views for v in seen] for k in range(3)
    ]
    response = response_of(curves)
    models, quality = [], _projector_quality(response, curves)
    for i, side in enumerate(SIDES):
        known = None if calibration is None else (calibration.left_color, calibration.right_color)[i].black
        known = known if known is not None and known.any() else None  # zero: nobody measured it
        covered = None if dark is None else [pair[i] for pair in dark]
        model, more = _camera(views[i], roles, response, covered, known, side)
        models.append(model)
        quality[side] = more
    registration: Registration | None = None
    if calibration is not None and set(roles.single) == set(roles.coarse) == {"x", "y"}:
        lateral = _lateral(views, models, roles, calibration, response, shown)
        models = [replace(m, lateral=one) for m, one in zip(models, lateral.cameras, strict=True)]
        registration = lateral.registration
        for side, before, after in zip(SIDES, lateral.before_px, lateral.after_px, strict=True):
            quality[side] |= {"lateral_before_px": before, "lateral_after_px": after}
    _check(views, models, sequence, roles, quality)
    balance = {s: np.mean([v.full[v.area].mean(axis=0, dtype=np.float64) for v in seen], axis=0)
               for s, seen in zip(SIDES, views, strict=True)}  # fmt: skip
    advice = tuple(line for side in SIDES for line in _advice(side, balance[side], quality[side]["peak"]))
    return ColorSolution(models[0], models[1], response, registration, balance, quality, advice)


def _view(pictures: Pictures, roles: Roles) -> _View:
    black = pictures.mean(roles.black)
    own = [pictures.planes(roles.levels[k][-1][1])[..., k] - black[..., k] for k in range(3)]
    full = np.stack(own, axis=-1)
    area = white_area(pictures, full)
    for levels in roles.levels:
        pictures.refuse_clipped(levels[-1][1], area)
    return _View(pictures, black, full, area)


def _camera(
    views: Sequence[_View], roles: Roles, response: Response, dark: Sequence[NDArray[np.uint8]] | None,
    known: Array | None, side: str,
) -> tuple[ColorModel, dict[str, Any]]:  # fmt: skip
    """Colour model of one camera without lateral colour, and its quality."""
    samples: list[MixSamples] = [mix_samples(v.pictures, list(roles.single.values()), v.area) for v in views]
    crosstalk, sigma, scatter = crosstalk_of(samples, side)
    blacks = [black_level(v.pictures, roles, v.black, v.full, v.area, dark=dark, known=known) for v in views]
    black = np.mean([level for level, _ in blacks], axis=0)
    balance = np.mean([balance_of(v.full, v.area) for v in views], axis=0)
    off = ~np.eye(3, dtype=bool)
    quality: dict[str, Any] = {
        "black_from": blacks[0][1],
        "crosstalk_sigma": float(sigma[off].max()),
        "crosstalk_scatter": float(scatter[off].max()),
        "white_share": float(np.mean([v.area.mean() for v in views])),
        "peak": max(_peak(v, crosstalk) for v in views),
    }
    sums = [_additivity(v, roles, response, crosstalk) for v in views]
    if all(s is not None for s in sums):
        quality["additivity"] = float(np.mean([s for s in sums if s is not None]))
    return ColorModel(black, crosstalk, f"cameras.{side}.color", balance), quality


def _peak(view: _View, crosstalk: Array) -> float:
    """Counts that the brightest part of the white area will have at the standard colour fringe's peak."""
    top = np.percentile(view.full[view.area], 98, axis=0)
    lights = np.where(np.eye(3, dtype=bool), 245.5, 68.5) / 255
    return float((view.black[view.area].mean(axis=0) + (lights * top) @ crosstalk.T).max())


def _additivity(view: _View, roles: Roles, response: Response, crosstalk: Array) -> float | None:
    """White light over the sum of its colours alone; None when white is clipped. Projectors that add white miss 1."""
    for index, level in roles.white:
        if view.pictures.clipped(index, view.area).max() > 0.001:
            continue
        white = (view.pictures.planes(index) - view.black)[view.area].mean(axis=0, dtype=np.float64)
        light = response.light(np.full((1, 3), float(level)))[0] / 255
        expected = crosstalk @ (light * view.full[view.area].mean(axis=0, dtype=np.float64))
        return float(white.sum() / expected.sum())
    return None


def _lateral(
    views: Sequence[Sequence[_View]], models: Sequence[ColorModel], roles: Roles, calibration: Calibration,
    response: Response, shown: Response | None,
) -> LateralSolution:  # fmt: skip
    seen: list[list[Offsets]] = [
        [
            measure_offsets(
                v.pictures, roles, v.area, black=v.black, full=v.full, crosstalk=model.crosstalk,
                response=response, shown=shown,
            )
            for v in one
        ]
        for one, model in zip(views, models, strict=True)
    ]  # fmt: skip
    return fit_lateral(seen, (calibration.left, calibration.right), calibration.projector.size)


def _projector_quality(response: Response, curves: Sequence[Sequence[LevelCurve]]) -> dict[str, Any]:
    inner = slice(1, -1)
    sigma = max(float(c.sigma[inner].max()) for seen in curves for c in seen) if len(curves[0][0].levels) > 2 else 0.0
    middle = response.light(np.full((1, 3), 127.5))[0] / 255
    gamma = np.log(np.maximum(middle, 1e-6)) / np.log(0.5)
    return {"response_sigma": sigma, "gamma": dict(zip(CHANNELS, gamma.round(4).tolist(), strict=True))}


def _check(
    views: Sequence[Sequence[_View]], models: Sequence[ColorModel], sequence: Frames, roles: Roles,
    quality: dict[str, Any],
) -> None:  # fmt: skip
    """Phase errors of the colour fringes in the sequence, before and after, into ``quality``."""
    for index, reference in roles.shots[:1]:
        pattern = sequence.frames[index]
        if not isinstance(pattern, ColorFringe):
            continue
        for side, seen, model in zip(SIDES, views, models, strict=True):
            both = [error_of(seen[0].pictures, index, pattern, reference, color=c, area=seen[0].area)
                    for c in (None, model)]  # fmt: skip
            quality[side]["phase_error_rad"] = [e.rms_rad for e in both]


def _advice(side: str, counts: Array, peak: float) -> list[str]:
    out = []
    if not GOOD_PEAK[0] <= peak <= GOOD_PEAK[1]:
        change = "lengthen" if peak < GOOD_PEAK[0] else "shorten"
        out.append(
            f"{side} camera: the white board peaks at {peak:.0f} counts, {GOOD_PEAK[0]:.0f} to {GOOD_PEAK[1]:.0f} are "
            f"best; {change} the exposure"
        )
    if counts.max() / counts.min() > UNEVEN_BALANCE:
        weak = CHANNELS[int(counts.argmin())]
        gains = ", ".join(f"{n} x {counts.max() / c:.2f}" for n, c in zip(CHANNELS, counts, strict=True))
        out.append(
            f"{side} camera: {weak} is the weakest channel; fixed gains ({gains}) in the camera or a weaker light of "
            "the other colours in the projector would even them out"
        )
    return out


def _name(frame: Uniform | Fringe | ColorFringe) -> str:
    if isinstance(frame, Uniform):
        return "even light " + " ".join(str(level) for level in frame.color)
    if isinstance(frame, Fringe):
        return f"fringe of {' '.join(frame.channels)} along {frame.axis}, shift {np.degrees(frame.shift):.0f} degrees"
    return f"colour fringe of {frame.periods:g} periods along {frame.axis}"
