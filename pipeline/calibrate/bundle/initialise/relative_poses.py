"""Relative poses of separately calibrated devices, by the vote of the views, and one state of all."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.state import State
from pipeline.calibrate.bundle.initialise.board_symmetry import Symmetry
from pipeline.calibrate.bundle.initialise.single_device import Mono

Array = NDArray[np.float64]
Pose = tuple[Array, Array]

ROTATION_LIMIT = np.radians(4.0)
SHIFT_LIMIT = 0.06
"""A view agrees with a relative pose if it differs by less than this rotation and this share of the distance."""


@dataclass(frozen=True, slots=True, eq=False)
class Vote:
    """The pose of one device relative to another, by the views.

    Args:
        rotation, translation: (3, 3) and (3,), from the reference device to this one.
        agreeing: view -> the symmetry of this device's numbering with which the view agrees.
        differing: views that agree with none.
        rotation_errors_deg, shift_errors: view -> its deviation, degrees and share of the distance.
    """

    rotation: Array
    translation: Array
    agreeing: dict[int, Symmetry] = field(default_factory=dict)
    differing: tuple[int, ...] = ()
    rotation_errors_deg: dict[int, float] = field(default_factory=dict)
    shift_errors: dict[int, float] = field(default_factory=dict)


def relative(reference: Pose, pose: Pose, symmetry: Symmetry, *, flipped: bool = False) -> Pose:
    """From the reference device to the other, if the other's marks are renumbered by the symmetry.

    With ``flipped`` the other device's image is a mirror image, left to right.
    """
    r, t = pose
    # The other device detected mark m where mark permutation[m] is: X_old = rotation^T (X_new - shift).
    r, t = r @ symmetry.rotation.T, t - r @ symmetry.rotation.T @ symmetry.shift
    if flipped:
        # Its pose belongs to a mirrored u axis, and so to a mirrored board, which is flat: z does not matter.
        mirror = np.diag([-1.0, 1.0, 1.0])
        r, t = mirror @ r @ np.diag([1.0, 1.0, -1.0]), mirror @ t
    rotation = r @ reference[0].T
    return rotation, t - rotation @ reference[1]


def vote(
    reference: dict[int, Pose], poses: dict[int, Pose], symmetries: Sequence[Symmetry], *, flipped: bool = False
) -> Vote | None:
    """The relative pose that most shared views agree on, each with the symmetry that fits it best.

    Every view and symmetry makes a proposal; the one with the least truncated distance to all views wins. The first
    symmetry is preferred where several agree. None without a shared view.
    """
    shared = sorted(set(reference) & set(poses))
    if not shared:
        return None
    candidates = [[relative(reference[v], poses[v], s, flipped=flipped) for s in symmetries] for v in shared]
    rotations = np.array([[c[0] for c in row] for row in candidates])
    shifts = np.array([[c[1] for c in row] for row in candidates])
    size = float(np.median([np.linalg.norm(poses[v][1]) for v in shared]))
    best, least = (0, 0), np.inf
    for k in range(len(shared)):
        for s in range(len(symmetries)):
            distances = _distances(rotations, shifts, rotations[k, s], shifts[k, s], size)
            distances = distances + np.where(np.arange(len(symmetries)) == 0, 0.0, 1e-3)
            total = float(np.minimum(distances.min(axis=1), 1.0).sum())
            if total < least - 1e-9:
                best, least = (k, s), total
    rotation, translation = rotations[best], shifts[best]
    for _ in range(3):
        distances = _distances(rotations, shifts, rotation, translation, size)
        choice = (distances + np.where(np.arange(len(symmetries)) == 0, 0.0, 1e-3)).argmin(axis=1)
        near = distances[np.arange(len(shared)), choice] < 1
        if not near.any():
            break
        rotation = mean_rotation(rotations[np.arange(len(shared)), choice][near])
        translation = np.median(shifts[np.arange(len(shared)), choice][near], axis=0)
    distances = _distances(rotations, shifts, rotation, translation, size)
    choice = (distances + np.where(np.arange(len(symmetries)) == 0, 0.0, 1e-3)).argmin(axis=1)
    rows = range(len(shared))
    return Vote(
        rotation,
        translation,
        {shared[k]: symmetries[choice[k]] for k in rows if distances[k, choice[k]] < 1},
        tuple(shared[k] for k in rows if distances[k, choice[k]] >= 1),
        {shared[k]: float(np.degrees(_angles(rotations[k, choice[k]], rotation))) for k in rows},
        {shared[k]: float(np.linalg.norm(shifts[k, choice[k]] - translation) / size) for k in rows},
    )


def _angles(rotations: Array, rotation: Array) -> Array:
    trace = np.einsum("...ij,ij->...", rotations, rotation)
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1, 1)))


def _distances(rotations: Array, shifts: Array, rotation: Array, translation: Array, size: float) -> Array:
    shift = np.linalg.norm(shifts - translation, axis=-1) / size
    return np.maximum(_angles(rotations, rotation) / ROTATION_LIMIT, shift / SHIFT_LIMIT)


def mean_rotation(rotations: Array) -> Array:
    """The rotation nearest to the element-wise median of rotations (n, 3, 3)."""
    u, _, vt = np.linalg.svd(np.median(rotations, axis=0))
    return np.asarray(u @ np.diag([1, 1, np.linalg.det(u @ vt)]) @ vt)


def assemble(monos: Sequence[Mono], votes: Sequence[Pose], poses: Sequence[dict[int, Pose]], views: int) -> State:
    """One state of all devices: intrinsics of each, poses from the votes, boards from the first that detected them.

    Args:
        monos: by device.
        votes: by device, world to device; the first is the identity.
        poses: by device, board to device by view, numbering repaired.
        views: how many.
    """
    rotations, translations = np.tile(np.eye(3), (views, 1, 1)), np.tile([0.0, 0.0, 1.0], (views, 1))
    for view in range(views):
        for (rotation, shift), own in zip(votes, poses, strict=True):
            if view in own:
                r, t = own[view]
                rotations[view], translations[view] = rotation.T @ r, rotation.T @ (t - shift)
                break
    return State(
        np.concatenate([m.state.intrinsics for m in monos]),
        np.stack([rotation for rotation, _ in votes]),
        np.stack([shift for _, shift in votes]),
        rotations,
        translations,
        monos[0].state.points,
    )
