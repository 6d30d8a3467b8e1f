"""One camera as the reference: its tables, and those of the other devices seen from it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.geometry.ray_tables import DepthScale, RayTable, packed, period_in_image, ray_table
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume

F32 = NDArray[np.float32]
F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Tables of one camera (``calibration.left``; see :meth:`Calibration.swapped`) and of the others seen from it.

    Args:
        table: what lattice pixels see; depth: scale of the parameter s.
        other, projector: packed models; phase_to_column: table of projector coordinates on an even grid of phases;
            column_to_phase: its inverse; all float32, for kernels; linear: both tables are straight lines.
        slopes: expected phase step per pixel (x, y); labels: most orders a pixel can have.
        order_step: change of s from one order to the next, mid-volume.
        first_axis: 0 when the phase grows along u; extent: projector pixels across.
    """

    table: RayTable
    depth: DepthScale
    other: F32
    projector: F32
    phase_to_column: F32
    column_to_phase: F32
    linear: bool
    slopes: tuple[float, float]
    labels: int
    order_step: float
    first_axis: int
    extent: float
    settings: Settings

    @staticmethod
    def of(
        calibration: Calibration, pattern: ColorFringe, volume: Volume, settings: Settings,
        inside: tuple[CameraModel, Volume] | None = None, coarser: int = 1, measured: Volume | None = None,
    ) -> View:  # fmt: skip
        """Build the tables of the calibration's left camera.

        Args:
            volume: in which orders are searched; measured: in the middle of which the slopes hold, the same by default.
        """
        axis = pattern.axis
        depth = DepthScale.of(volume)
        middle = DepthScale.of(measured or volume)
        period = period_in_image(calibration, middle, axis=axis, period=pattern.length / pattern.periods)
        step = (settings.lattice_x, coarser * settings.lattice_y)
        table = ray_table(calibration, depth, axis=axis, step=step if axis == "x" else step[::-1], inside=inside)
        sign = _growth(calibration, middle, axis)
        slope = sign * 2 * np.pi / period
        slopes = (slope, 0.0) if axis == "x" else (0.0, slope)
        along = table.along.astype(np.float64)
        far, near = ((along[0] + along[1] * s) / (1 + along[2] * s) for s in table.limits.astype(np.float64))
        phases = pattern.phase
        across_volume = np.abs(np.interp(near, np.arange(len(phases)), phases)
                               - np.interp(far, np.arange(len(phases)), phases))  # fmt: skip
        widest = float(across_volume.max()) / (2 * np.pi)
        return View(
            table, depth, packed(calibration.right).astype(np.float32),
            packed(calibration.projector).astype(np.float32), _even_table(pattern).astype(np.float32),
            phases.astype(np.float32), pattern.profile is None, slopes, int(widest) + 2,
            1 / max(widest, 1e-3), 0 if axis == "x" else 1, float(pattern.size[1] if axis == "x" else pattern.size[0]),
            settings,
        )  # fmt: skip


def _even_table(pattern: ColorFringe) -> F64:
    """(first phase, step, projector coordinates ...) on an even grid of phases, half a pixel beyond both ends."""
    phases = pattern.phase
    lowest = phases[0] - 0.5 * (phases[1] - phases[0])
    highest = phases[-1] + 0.5 * (phases[-1] - phases[-2])
    n = 2 * len(phases) if pattern.profile is None else 16 * len(phases)
    grid = np.linspace(lowest, highest, n)
    return np.concatenate([[lowest, grid[1] - grid[0]], pattern.column_of(grid)])


def _growth(calibration: Calibration, depth: DepthScale, axis: str) -> float:
    """+1 when the phase grows with u (or v) in this camera's image, else -1."""
    width, height = calibration.left.size
    first = 0 if axis == "x" else 1
    centre = np.array([[width / 2, height / 2], [width / 2, height / 2]])
    centre[1, first] += 4.0
    rays = np.concatenate([calibration.left.normalise(centre), np.ones((2, 1))], axis=1)
    columns = calibration.projector.project(rays * depth.depth(0.5))[:, first]
    return 1.0 if columns[1] > columns[0] else -1.0
