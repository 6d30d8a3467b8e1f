"""Summary of the adjusted numbers as a :class:`pipeline.calibrate.bundle.solution.Solution`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust import circle_offsets
from pipeline.calibrate.bundle.adjust.adjustment import Adjusted, to_scale
from pipeline.calibrate.bundle.adjust.levenberg_marquardt import residuals
from pipeline.calibrate.bundle.adjust.parameterisation import names_of
from pipeline.calibrate.bundle.adjust.state import PER_DEVICE, PER_VIEW
from pipeline.calibrate.bundle.adjust.uncertainty import derived
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.quality.depth_sigma import depth_sigma_mm
from pipeline.calibrate.bundle.quality.reprojection_error import epipolar_px, rms
from pipeline.calibrate.bundle.solution import Rejection, Residuals, Solution
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]

_OTHER_CIRCLES = 0.2
"""Largest deviation of the circles' diameter: exposure and blur make a few per cent."""


def summarise(
    board: Board,
    views: Sequence[BoardView],
    devices: Sequence[str],
    sizes: Mapping[str, tuple[int, int]],
    adjusted: Adjusted,
    numbers: NDArray[np.int64],
    rejected: Sequence[Rejection],
    options: Options,
) -> Solution:
    """All figures of the result.

    Args:
        board: what was shown.
        views: all views.
        devices: names in the order of the unknowns.
        sizes: of their images.
        adjusted: the last adjustment.
        numbers: indices of its views in ``views``.
        rejected: earlier rejections.
        options: for the scale and the largest share of rejected marks.

    Raises:
        CalibrationError: too many marks did not fit.
    """
    _refuse_other_circles(board, adjusted)
    adjusted = to_scale(adjusted, options)
    state, data = adjusted.state, adjusted.data
    share = len(adjusted.out) / max(len(adjusted.out) + len(data), 1)
    single = _single_marks(adjusted, [views[k].name for k in numbers], devices)
    if share > options.most_marks:
        raise CalibrationError(
            f"{share:.0%} of the marks do not fit (limit {options.most_marks:.0%}): "
            f"{'; '.join(map(str, single[:4]))}; are board and numbering right, is the board flat?"
        )
    misfit = residuals(state, data, adjusted.offsets)
    models = {name: state.model(k, name, sizes[name]) for k, name in enumerate(devices)}
    count = PER_DEVICE * len(devices)
    values, sigma, covariance = derived(state, devices, adjusted.covariance[:count, :count])
    epipolar = sigma_mm = float("nan")
    if list(devices[:2]) == ["left", "right"]:
        epipolar = epipolar_px(models["left"], models["right"], data, adjusted.offsets)
        sigma_mm = depth_sigma_mm(state, data, adjusted.covariance[:count, :count], [sizes["left"], sizes["right"]])
    cameras = data.device < (2 if "right" in devices else len(devices))
    poses: list[tuple[Array, Array] | None] = [None] * len(views)
    for k, number in enumerate(numbers):
        poses[number] = (state.view_rotations[k], state.view_translations[k])
    parts = {
        (views[numbers[view]].name, devices[device]): Residuals(
            data.ids[where], data.pixels[where], misfit[where], data.sigma[where]
        )
        for device, view, where in data.groups()
    }
    by = [data.device == k for k in range(len(devices))]
    tail = adjusted.covariance[count + PER_VIEW * state.views :, count + PER_VIEW * state.views :]
    return Solution(
        devices=models,
        poses=poses,
        views=tuple(view.name for view in views),
        sigma=sigma,
        values=values,
        covariance=covariance,
        names=tuple(names_of(devices)),
        residuals=parts,
        rejected=(*rejected, *single),
        rms={name: rms(misfit[by[k]]) for k, name in enumerate(devices)},
        rms_stereo=rms(misfit[cameras]),
        sigma0={name: _sigma0(adjusted, by[k]) for k, name in enumerate(devices)},
        noise_px={name: float(np.sqrt((data.sigma[by[k]] ** 2).mean())) for k, name in enumerate(devices)},
        epipolar_px=epipolar,
        baseline_mm=values.get("baseline_mm", float("nan")),
        angle_deg=values.get("angle_deg", float("nan")),
        board_points=state.points,
        diameter_mm=adjusted.diameter_mm,
        views_used=len(numbers),
        views_rejected=len(views) - len(numbers),
        offsets_px=float(np.linalg.norm(adjusted.offsets, axis=1).max(initial=0.0)),
        steps=adjusted.fit.steps,
        scale=_scale(board, options),
        sigma_calibration_mm=sigma_mm,
        board_sigma_mm=np.sqrt(np.maximum(np.diag(tail), 0)).reshape(-1, 3) if len(tail) else None,
    )


def _refuse_other_circles(board: Board, adjusted: Adjusted) -> None:
    """Raise if the circles have another size, relative to their pitch, than the board's."""
    measured = circle_offsets.diameter_mm(adjusted.state, adjusted.data)
    nominal = board.diameter_mm if board.round else 0.0
    if nominal and measured and abs(measured / nominal - 1) > _OTHER_CIRCLES:
        raise CalibrationError(
            f"the circles measure {measured:.1f} mm if their pitch is {board.pitch_mm:g} mm, but {board} has "
            f"{nominal:g} mm: give the board that was shown"
        )


def _scale(board: Board, options: Options) -> str:
    if options.known_distance is not None:
        first, second, length = options.known_distance
        return f"the distance of {length:g} mm between marks {first} and {second}"
    if options.board_refined:
        return f"the mean pitch of {board.pitch_mm:g} mm: the best fit of all marks to the nominal grid has the scale 1"
    return f"the pitch of {board.pitch_mm:g} mm"


def _sigma0(adjusted: Adjusted, chosen: NDArray[np.bool_]) -> float:
    return float(np.sqrt((adjusted.data.sigma[chosen] ** 2).mean() / (adjusted.expected_sigma[chosen] ** 2).mean()))


def _single_marks(adjusted: Adjusted, names: Sequence[str], devices: Sequence[str]) -> list[Rejection]:
    result = []
    for device, view, where in adjusted.out.groups():
        by = adjusted.out_by[where]
        pixels = by * adjusted.out.sigma[where]
        reason = (
            f"off by {', '.join(f'{value:.3g}' for value in pixels)} px, "
            f"{', '.join(f'{value:.3g}' for value in by)} standard deviations"
        )
        ids = tuple(int(number) for number in adjusted.out.ids[where])
        result.append(Rejection(names[view], devices[device], ids, reason))
    return result
