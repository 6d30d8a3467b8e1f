"""Parameterisation of the unknowns: held parameters, a fixed aspect ratio, the gauge of a refined board."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.state import INTRINSICS, POSE
from pipeline.calibrate.bundle.options import Options
from pipeline.common.errors import CalibrationError

Array = NDArray[np.float64]

GAUGE_WEIGHT = 1e6
"""Weight of the gauge conditions, 1/mm^2: they are independent of the data, so any weight gives the same board."""
LOOSE = 0.25
"""Prior of a refined mark about its nominal position, in pitches: it matters only for marks with few detections."""


@dataclass(frozen=True, slots=True, eq=False)
class Parameterisation:
    """The free directions of the unknowns.

    Args:
        basis: (16 d, k): columns are the independent directions of the devices' unknowns.
        points: whether the marks on the board are adjusted.
        nominal: (n, 3) their nominal positions.
        pitch_mm: of the board.
    """

    basis: Array
    points: bool
    nominal: Array
    pitch_mm: float

    def gauge(self) -> Array:
        """(7, 3 n): shifts, rotations and the scale of the whole board, orthonormal rows.

        They are held: the best fit of a refined board to the nominal grid (over all marks) keeps the grid's pose and
        the scale 1, so that the mean printed pitch fixes the scale of the world.
        """
        p = self.nominal - self.nominal.mean(axis=0)
        n, zero = len(p), np.zeros(len(p))
        shifts = [np.tile(np.eye(3)[k], (n, 1)) for k in range(3)]
        rotations = [
            np.stack([zero, -p[:, 2], p[:, 1]], 1),
            np.stack([p[:, 2], zero, -p[:, 0]], 1),
            np.stack([-p[:, 1], p[:, 0], zero], 1),
        ]
        rows = np.stack([a.ravel() for a in (*shifts, *rotations, p)])
        return np.asarray(np.linalg.svd(rows, full_matrices=False)[2])


def names_of(devices: Sequence[str]) -> list[str]:
    """Names of the devices' unknowns, as ``left.fx`` and ``right.rotation_x``, in the order of the vector."""
    return [f"{device}.{key}" for device in devices for key in (*INTRINSICS, *POSE)]


def parameterise(
    devices: Sequence[str], options: Options, nominal: Array, pitch_mm: float, *, held: Sequence[str] = ()
) -> Parameterisation:
    """The parameterisation by the options; ``held``: more parameters, without device, that are not adjusted.

    Raises:
        CalibrationError: ``options.fixed`` names something that does not exist.
    """
    names = names_of(devices)
    held_names = {name for name in names if name.split(".")[1] in held}
    if not options.skew:
        held_names |= {name for name in names if name.endswith(".skew")}
    if not options.k3:
        held_names |= {name for name in names if name.endswith(".k3")}
    if not options.tangential:
        held_names |= {name for name in names if name.endswith((".p1", ".p2"))}
    held_names |= {f"{devices[0]}.{key}" for key in POSE}
    for name in options.fixed:
        matching = {one for one in names if one == name or one.startswith(f"{name}.")}
        if not matching:
            raise CalibrationError(f"fixed parameter {name!r}: expected a device or a parameter such as {names[0]}")
        held_names |= matching
    columns = []
    for at, name in enumerate(names):
        device, key = name.split(".")
        if name in held_names or (options.aspect is not None and key == "fx" and f"{device}.fy" not in held_names):
            continue
        column = np.zeros(len(names))
        column[at] = 1.0
        if options.aspect is not None and key == "fy" and f"{device}.fx" not in held_names:
            column[at - 1] = 1 / options.aspect
        columns.append(column)
    basis = np.stack(columns, axis=1) if columns else np.zeros((len(names), 0))
    return Parameterisation(basis, options.board_refined, nominal, pitch_mm)
