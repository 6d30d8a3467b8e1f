"""Joint calibration of up to three devices from views of a board (Zhang, 2000; Triggs et al., 2000)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.adjustment import Adjusted, adjust
from pipeline.calibrate.bundle.adjust.observations import Observations, gather
from pipeline.calibrate.bundle.adjust.parameterisation import names_of, parameterise
from pipeline.calibrate.bundle.adjust.state import State
from pipeline.calibrate.bundle.initialise.relative_pose_check import JointEstimate, joint_estimate
from pipeline.calibrate.bundle.initialise.relative_poses import assemble
from pipeline.calibrate.bundle.initialise.single_device import Mono, mono
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.quality.observability import require_determined
from pipeline.calibrate.bundle.quality.view_assessment import assess_views, require_non_degenerate
from pipeline.calibrate.bundle.solution import Rejection, Solution
from pipeline.calibrate.bundle.summary import summarise
from pipeline.calibrate.bundle.view_rejection import bad_views, few_marks
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError
from pipeline.rig.camera_model import CameraModel

Array = NDArray[np.float64]

DEVICES = ("left", "right", "projector")
_MOST_REFINED = 600


def calibrate(
    board: Board,
    views: Sequence[BoardView],
    sizes: Mapping[str, tuple[int, int]],
    *,
    options: Options | None = None,
    start: Mapping[str, CameraModel] | None = None,
) -> Solution:
    """Intrinsics and poses of all devices, with their uncertainties.

    One adjustment over all marks of all devices; each view has one pose of the board, shared by the devices. Marks
    with areas are centroids of circles and are predicted as such.

    Args:
        board: what was shown.
        views: marks by device; a view may lack a device.
        sizes: (width, height) by device; it names the devices to be calibrated, some of :data:`DEVICES`. The first of
            them in that order is the world.
        options: choices.
        start: known devices, for first values; without them all values are initialised from the marks.

    Raises:
        CalibrationError: the views cannot be used; the message names the cause and the remedy.
    """
    options = options or Options()
    devices = [name for name in DEVICES if name in sizes]
    if not devices or len(devices) != len(sizes):
        raise CalibrationError(f"devices {', '.join(sizes) or 'none'}: expected some of {', '.join(DEVICES)}")
    names = [view.name for view in views]
    if len(set(names)) < len(names):
        raise CalibrationError(f"view {max(names, key=names.count)} occurs twice: give every view its own name")
    if options.board_refined and len(board.points) > _MOST_REFINED:
        raise CalibrationError(
            f"board {board} has {len(board.points)} marks; at most {_MOST_REFINED} can be refined, take a coarser board"
        )
    start = start or {}
    data, rejected = few_marks(gather(board, views, devices), board, views, devices, options)
    _require_views(data, views, options, rejected)
    assessment = assess_views(board, views, sizes, start=start)
    if options.check:
        require_non_degenerate(assessment)
    monos = [
        mono(data.of(number), board.points, len(views), sizes[name], options, name=name, start=start.get(name))
        for number, name in enumerate(devices)
    ]
    joint = joint_estimate(board, views, devices, data, monos, options)
    rejected += joint.rejected
    _fix_poses(joint, devices, options, start)
    adjusted, numbers, more = _adjust_and_reject(board, views, devices, joint, options, monos)
    solution = summarise(board, views, devices, sizes, adjusted, numbers, rejected + more, options)
    if options.check:
        require_determined(solution, sizes, options, assessment)
    return solution


def _fix_poses(
    joint: JointEstimate, devices: Sequence[str], options: Options, start: Mapping[str, CameraModel]
) -> None:
    """Give devices whose pose is held the pose of the start instead of that of the views."""
    names = names_of(devices)
    for number, name in enumerate(devices[1:], start=1):
        pose = {one for one in names if one.startswith((f"{name}.rotation_", f"{name}.translation_"))}
        held = {one for one in pose if one in options.fixed or name in options.fixed}
        if held and name in start and devices[0] in start:
            first, own = start[devices[0]], start[name]
            rotation = own.rotation @ first.rotation.T
            joint.devices[number] = (rotation, own.translation - rotation @ first.translation)


def _require_views(data: Observations, views: Sequence[BoardView], options: Options, rejected: list[Rejection]) -> None:
    count = len(np.unique(data.view))
    if count < options.least_views:
        why = f" ({'; '.join(map(str, rejected[:5]))})" if rejected else ""
        raise CalibrationError(
            f"{count} of {len(views)} views can be used, at least {options.least_views} are needed{why}; add views of "
            "the board, tilted by 20 to 40 degrees about both axes"
        )


def _adjust_and_reject(
    board: Board, views: Sequence[BoardView], devices: list[str], joint: JointEstimate, options: Options,
    monos: Sequence[Mono]
) -> tuple[Adjusted, NDArray[np.int64], list[Rejection]]:  # fmt: skip
    """Adjust and reject bad views until the others agree."""
    data, rejected = joint.data, list[Rejection]()
    state = assemble(monos, joint.devices, joint.poses, len(views))
    remaining = int(options.most_views * len(views)) - joint.rejected_views
    while True:
        state_, data_ = _compact(state, data)
        free = parameterise(devices, options, board.points, board.pitch_mm)
        adjusted = adjust(state_, data_, free, options, board)
        numbers = np.unique(data.view)
        worse = bad_views(adjusted, [views[k].name for k in numbers], devices, options)
        if not worse:
            return adjusted, numbers, rejected
        remaining -= len({view for view, _, _ in worse})
        rejected += [rejection for _, _, rejection in worse]
        if remaining < 0:
            raise CalibrationError(
                f"more than {options.most_views:.0%} of the views do not fit the others: "
                f"{'; '.join(map(str, rejected[:6]))}; are board, order of the images and numbering right?"
            )
        for view, device, _ in worse:
            rejected_marks = data.view == numbers[view]
            data = data.some(~(rejected_marks if device is None else rejected_marks & (data.device == device)))
        _require_views(data, views, options, rejected)


def _compact(state: State, data: Observations) -> tuple[State, Observations]:
    """Only the views that have marks, numbered without gaps."""
    numbers = np.unique(data.view)
    state = state.with_views(state.view_rotations[numbers], state.view_translations[numbers])
    view = np.searchsorted(numbers, data.view).astype(np.int64)
    return state, Observations(data.device, view, data.mark, data.pixels, data.sigma, data.area, data.ids)
