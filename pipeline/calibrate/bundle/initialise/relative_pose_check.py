"""Relative poses of the devices, and repair or rejection of views that contradict them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.initialise.board_symmetry import Symmetry, symmetries
from pipeline.calibrate.bundle.initialise.relative_poses import Pose, Vote, vote
from pipeline.calibrate.bundle.initialise.single_device import Mono
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.solution import Rejection
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]


@dataclass(slots=True)
class JointEstimate:
    """First joint values.

    Args:
        data: the marks that agree, numbering repaired.
        devices: by device, (R, t) world to device.
        poses: by device, view -> (R, t) board to device.
        rejected: repairs and rejections.
        rejected_views: views that were rejected altogether.
    """

    data: Observations
    devices: list[Pose]
    poses: list[dict[int, Pose]]
    rejected: list[Rejection]
    rejected_views: int = 0


def joint_estimate(
    board: Board,
    views: Sequence[BoardView],
    devices: Sequence[str],
    data: Observations,
    monos: Sequence[Mono],
    options: Options,
) -> JointEstimate:
    """Relative poses by the vote of the views; views that contradict it are renumbered or rejected.

    Raises:
        CalibrationError: images are mirrored or swapped, or fewer than half of the views agree.
    """
    renumberings = symmetries(board)
    joint = JointEstimate(data, [(np.eye(3), np.zeros(3))], [{v: m.pose(v) for v in m.seen} for m in monos], [])
    for number, device in enumerate(devices):
        _repair_mirrored(joint, number, device, views, monos[number], renumberings)
    proper = [s for s in renumberings if not s.mirrored]
    for number in range(1, len(devices)):
        reference, best = _first_vote(joint, number, proper)
        if reference is None or best is None:
            raise CalibrationError(
                f"{devices[number]} shares no view of the board with {' or '.join(devices[:number])}: show the board "
                "in the field of view of both"
            )
        _refuse_contradiction(joint, reference, number, best, devices, views, renumberings)
        rotation, shift = joint.devices[reference]
        joint.devices.append((best.rotation @ rotation, best.rotation @ shift + best.translation))
        _repair(joint, reference, number, best, devices, views)
    _check_rejections(joint, views, options)
    if len(devices) > 1 and devices[:2] == ["left", "right"]:
        _refuse_swapped(joint.devices[1])
    return joint


def _relabelled(pose: Pose, symmetry: Symmetry) -> Pose:
    r = pose[0] @ symmetry.rotation.T
    return r, pose[1] - r @ symmetry.shift


def _repair_mirrored(
    joint: JointEstimate, number: int, device: str, views: Sequence[BoardView], mono: Mono, renumberings: list[Symmetry]
) -> None:
    """Renumber views whose numbering shows the board from behind where the grid allows it, or reject them."""
    behind = [view for view in mono.seen if not mono.front[view]]
    if not behind:
        return
    if len(behind) * 2 > len(mono.seen):
        raise CalibrationError(
            f"the images of {device} show the board from behind ({len(behind)} of {len(mono.seen)} views): they are "
            "mirror images, or the marks are numbered from the wrong side; switch off the camera's flip, or correct "
            "the board's description"
        )
    mirrored = next((s for s in renumberings if s.mirrored), None)
    for view in behind:
        if mirrored is None:
            _drop(joint, view, number)
            joint.rejected.append(Rejection(views[view].name, device, (), "its numbering shows the board from behind"))
            continue
        joint.data = joint.data.renumbered(number, view, mirrored.permutation)
        joint.poses[number][view] = _relabelled(joint.poses[number][view], mirrored)
        joint.rejected.append(
            Rejection(views[view].name, device, (), "its numbering was mirrored and was turned over", repaired=True)
        )


def _first_vote(joint: JointEstimate, number: int, proper: list[Symmetry]) -> tuple[int | None, Vote | None]:
    """The vote against the earlier device that shares the most views."""
    counts = [len(set(joint.poses[k]) & set(joint.poses[number])) for k in range(number)]
    for reference in sorted(range(number), key=lambda k: -counts[k]):
        best = vote(joint.poses[reference], joint.poses[number], proper)
        if best is not None:
            return reference, best
    return None, None


def _refuse_contradiction(
    joint: JointEstimate, reference: int, number: int, best: Vote, devices: Sequence[str], views: Sequence[BoardView],
    renumberings: list[Symmetry]
) -> None:  # fmt: skip
    shared = len(best.rotation_errors_deg)
    if 2 * len(best.agreeing) > shared:
        return
    first, second = devices[reference], devices[number]
    mirrored = [s for s in renumberings if s.mirrored]
    flipped = vote(joint.poses[reference], joint.poses[number], mirrored, flipped=True) if mirrored else None
    if flipped is not None and 2 * len(flipped.agreeing) > shared and len(flipped.agreeing) > len(best.agreeing) + 1:
        culprit = second if flipped.translation[0] < 0 or second == "projector" else first
        raise CalibrationError(
            f"the images of {culprit} are mirrored, left to right: {len(flipped.agreeing)} of {shared} views agree "
            f"when they are turned over, {len(best.agreeing)} as they are; switch off the flip of {culprit}"
        )
    worst = max(best.rotation_errors_deg, key=lambda view: best.rotation_errors_deg[view])
    raise CalibrationError(
        f"{first} and {second} contradict each other: only {len(best.agreeing)} of {shared} views agree on their "
        f"relative pose (worst {views[worst].name}: off by {best.rotation_errors_deg[worst]:.1f} degrees); do the "
        "images of a pair belong together (same order of the files), and did the board hold still?"
    )


def _repair(
    joint: JointEstimate,
    reference: int,
    number: int,
    best: Vote,
    devices: Sequence[str],
    views: Sequence[BoardView],
) -> None:
    for view, symmetry in best.agreeing.items():
        if symmetry.name == "as numbered":
            continue
        joint.data = joint.data.renumbered(number, view, symmetry.permutation)
        joint.poses[number][view] = _relabelled(joint.poses[number][view], symmetry)
        joint.rejected.append(
            Rejection(
                views[view].name,
                devices[number],
                (),
                f"its numbering was {symmetry.name} against {devices[reference]}; repaired",
                repaired=True,
            )
        )
    for view in best.differing:
        reason = (
            f"the board has different poses for {devices[number]} and {devices[reference]}: off by "
            f"{best.rotation_errors_deg[view]:.1f} degrees and {best.shift_errors[view]:.1%} of the distance; it "
            "moved between the images, or marks are wrong"
        )
        # A third device may agree with the reference; without one it is undecided which of the two is wrong.
        third = any(view in joint.poses[k] for k in range(len(devices)) if k not in (number, reference))
        joint.rejected.append(Rejection(views[view].name, devices[number] if third else "", (), reason))
        _drop(joint, view, number)
        if not third:
            _drop(joint, view, reference)


def _drop(joint: JointEstimate, view: int, number: int) -> None:
    joint.poses[number].pop(view, None)
    joint.data = joint.data.some((joint.data.view != view) | (joint.data.device != number))


def _check_rejections(joint: JointEstimate, views: Sequence[BoardView], options: Options) -> None:
    rejections = [r for r in joint.rejected if not r.repaired]
    joint.rejected_views = len({r.view for r in rejections})
    if joint.rejected_views > options.most_views * len(views):
        raise CalibrationError(
            f"{joint.rejected_views} of {len(views)} views do not fit the others (limit {options.most_views:.0%}): "
            f"{'; '.join(map(str, rejections[:4]))}; are board, order of the images and numbering right?"
        )
    if len(np.unique(joint.data.view)) < options.least_views:
        raise CalibrationError(
            f"{len(np.unique(joint.data.view))} views are left, at least {options.least_views} are needed: "
            f"{'; '.join(map(str, rejections[:4]))}"
        )


def _refuse_swapped(right: Pose) -> None:
    rotation, shift = right
    centre = -rotation.T @ shift
    if centre[0] < -0.3 * np.linalg.norm(centre):
        raise CalibrationError(
            f"the right camera comes out {abs(centre[0]):.1f} mm to the left of the left one: either the images of "
            "left and right are swapped, or both cameras' images are mirrored (which has the same "
            "geometry); exchange them, or switch off the flip of both"
        )
