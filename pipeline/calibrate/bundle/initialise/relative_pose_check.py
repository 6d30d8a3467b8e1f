"""How the devices stand to each other, and views whose numbering or place contradicts the others."""

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
class Placed:
    """First joint values.

    Args:
        data: the marks that agree, numbering repaired.
        devices: by device, (R, t) world to device.
        poses: by device, view -> (R, t) board to device.
        rejected: what was repaired or left out.
        left_out: views that were left out altogether.
    """

    data: Observations
    devices: list[Pose]
    poses: list[dict[int, Pose]]
    rejected: list[Rejection]
    left_out: int = 0


def place(
    board: Board,
    views: Sequence[BoardView],
    devices: Sequence[str],
    data: Observations,
    monos: Sequence[Mono],
    options: Options,
) -> Placed:
    """Relative poses by the vote of the views; renumber or leave out views that contradict it.

    Raises:
        CalibrationError: images are mirrored or swapped, or fewer than half of the views agree.
    """
    known = symmetries(board)
    placed = Placed(data, [(np.eye(3), np.zeros(3))], [{v: m.pose(v) for v in m.seen} for m in monos], [])
    for number, device in enumerate(devices):
        _face_up(placed, number, device, views, monos[number], known)
    proper = [s for s in known if not s.mirrored]
    for number in range(1, len(devices)):
        reference, found = _first_vote(placed, number, proper)
        if reference is None or found is None:
            raise CalibrationError(
                f"{devices[number]} shares no view of the board with {' or '.join(devices[:number])}: show the board "
                "where both see it"
            )
        _refuse_contradiction(placed, reference, number, found, devices, views, known)
        turn, shift = placed.devices[reference]
        placed.devices.append((found.rotation @ turn, found.rotation @ shift + found.translation))
        _repair(placed, reference, number, found, devices, views)
    _leave_out(placed, views, options)
    if len(devices) > 1 and devices[:2] == ["left", "right"]:
        _refuse_swapped(placed.devices[1])
    return placed


def _relabelled(pose: Pose, symmetry: Symmetry) -> Pose:
    r = pose[0] @ symmetry.turn.T
    return r, pose[1] - r @ symmetry.shift


def _face_up(
    placed: Placed, number: int, device: str, views: Sequence[BoardView], own: Mono, known: list[Symmetry]
) -> None:  # fmt: skip
    """A view whose numbering shows the board from behind is mirrored; where the grid allows it is renumbered."""
    behind = [view for view in own.seen if not own.front[view]]
    if not behind:
        return
    if len(behind) * 2 > len(own.seen):
        raise CalibrationError(
            f"the images of {device} show the board from behind ({len(behind)} of {len(own.seen)} views): they are "
            "mirror images, or the marks are numbered from the wrong side; switch off the camera's flip, or correct "
            "the board's description"
        )
    mirrored = next((s for s in known if s.mirrored), None)
    for view in behind:
        if mirrored is None:
            _drop(placed, view, number)
            placed.rejected.append(Rejection(views[view].name, device, (), "its numbering shows the board from behind"))
            continue
        placed.data = placed.data.renumbered(number, view, mirrored.permutation)
        placed.poses[number][view] = _relabelled(placed.poses[number][view], mirrored)
        placed.rejected.append(
            Rejection(views[view].name, device, (), "its numbering was mirrored and was turned over", repaired=True)
        )


def _first_vote(placed: Placed, number: int, proper: list[Symmetry]) -> tuple[int | None, Vote | None]:
    """By the placed device that shares the most views."""
    counts = [len(set(placed.poses[k]) & set(placed.poses[number])) for k in range(number)]
    for reference in sorted(range(number), key=lambda k: -counts[k]):
        found = vote(placed.poses[reference], placed.poses[number], proper)
        if found is not None:
            return reference, found
    return None, None


def _refuse_contradiction(
    placed: Placed, reference: int, number: int, found: Vote, devices: Sequence[str], views: Sequence[BoardView],
    known: list[Symmetry]
) -> None:  # fmt: skip
    shared = len(found.turns_deg)
    if 2 * len(found.agreeing) > shared:
        return
    first, second = devices[reference], devices[number]
    mirrored = [s for s in known if s.mirrored]
    flipped = vote(placed.poses[reference], placed.poses[number], mirrored, flipped=True) if mirrored else None
    if flipped is not None and 2 * len(flipped.agreeing) > shared and len(flipped.agreeing) > len(found.agreeing) + 1:
        culprit = second if flipped.translation[0] < 0 or second == "projector" else first
        raise CalibrationError(
            f"the images of {culprit} are mirrored, left to right: {len(flipped.agreeing)} of {shared} views agree "
            f"when they are turned over, {len(found.agreeing)} as they are; switch off the flip of {culprit}"
        )
    worst = max(found.turns_deg, key=lambda view: found.turns_deg[view])
    raise CalibrationError(
        f"{first} and {second} contradict each other: only {len(found.agreeing)} of {shared} views agree on how they "
        f"stand to each other (worst {views[worst].name}: off by {found.turns_deg[worst]:.1f} degrees); do the "
        "images of a pair belong together (same order of the files), and did the board hold still?"
    )


def _repair(
    placed: Placed, reference: int, number: int, found: Vote, devices: Sequence[str], views: Sequence[BoardView]
) -> None:
    for view, symmetry in found.agreeing.items():
        if symmetry.name == "as numbered":
            continue
        placed.data = placed.data.renumbered(number, view, symmetry.permutation)
        placed.poses[number][view] = _relabelled(placed.poses[number][view], symmetry)
        placed.rejected.append(
            Rejection(
                views[view].name,
                devices[number],
                (),
                f"its numbering was {symmetry.name} against {devices[reference]}; repaired",
                repaired=True,
            )
        )
    for view in found.differing:
        reason = (
            f"the board stood differently for {devices[number]} and {devices[reference]}: off by "
            f"{found.turns_deg[view]:.1f} degrees and {found.shifts[view]:.1%} of the distance; it moved between the "
            "images, or marks are wrong"
        )
        # A third device may agree with the reference; without one nobody knows which of the two is wrong.
        third = any(view in placed.poses[k] for k in range(len(devices)) if k not in (number, reference))
        placed.rejected.append(Rejection(views[view].name, devices[number] if third else "", (), reason))
        _drop(placed, view, number)
        if not third:
            _drop(placed, view, reference)


def _drop(placed: Placed, view: int, number: int) -> None:
    placed.poses[number].pop(view, None)
    placed.data = placed.data.some((placed.data.view != view) | (placed.data.device != number))


def _leave_out(placed: Placed, views: Sequence[BoardView], options: Options) -> None:
    gone = [r for r in placed.rejected if not r.repaired]
    placed.left_out = len({r.view for r in gone})
    if placed.left_out > options.most_views * len(views):
        raise CalibrationError(
            f"{placed.left_out} of {len(views)} views do not fit the others (limit {options.most_views:.0%}): "
            f"{'; '.join(map(str, gone[:4]))}; are board, order of the images and numbering right?"
        )
    if len(np.unique(placed.data.view)) < options.least_views:
        raise CalibrationError(
            f"{len(np.unique(placed.data.view))} views are left, at least {options.least_views} are needed: "
            f"{'; '.join(map(str, gone[:4]))}"
        )


def _refuse_swapped(right: Pose) -> None:
    turn, shift = right
    centre = -turn.T @ shift
    if centre[0] < -0.3 * np.linalg.norm(centre):
        raise CalibrationError(
            f"the right camera comes out {abs(centre[0]):.1f} mm to the left of the left one: either the images of "
            "left and right are swapped, or both cameras' images are mirrored (which looks the same to the "
            "geometry); exchange them, or switch off the flip of both"
        )
