"""One camera as the reference: its tables, and the steps of the order search seen from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import aggregate, candidates, propagate
from pipeline.calibration import Calibration, ColorModel
from pipeline.camera_model import CameraModel
from pipeline.cloud import Volume
from pipeline.pattern import ColorFringe
from pipeline.phase import Decoder, PhaseMap
from pipeline.settings import Settings
from pipeline.tables import DepthScale, RayTable, packed, period_in_picture, ray_table

F64 = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """Tables of one camera (``calibration.left``; see :meth:`Calibration.swapped`) and of the others seen from it.

    Args:
        table: what lattice pixels see; depth: scale of the parameter s.
        other, projector: packed models; columns: even-grid table phase -> projector coordinate; phases: its inverse.
        slopes: expected phase step per pixel (x, y); labels: most orders a pixel can have.
        order_step: change of s from one order to the next, mid-volume.
        first_axis: 0 when the phase grows along u; extent: projector pixels across.
    """

    decoder: Decoder
    table: RayTable
    depth: DepthScale
    other: F64
    projector: F64
    columns: F64
    phases: F64
    slopes: tuple[float, float]
    labels: int
    order_step: float
    first_axis: int
    extent: float
    settings: Settings

    @staticmethod
    def of(
        calibration: Calibration, pattern: ColorFringe, volume: Volume, settings: Settings, color: ColorModel,
        mosaic: NDArray[np.int64] | None, inside: tuple[CameraModel, Volume] | None = None, coarser: int = 1,
    ) -> View:  # fmt: skip
        """Build the tables of the calibration's left camera."""
        axis = pattern.axis
        depth = DepthScale.of(volume)
        period = period_in_picture(calibration, depth, axis=axis, period=pattern.length / pattern.periods)
        step = (settings.lattice_x, coarser * settings.lattice_y)
        table = ray_table(calibration, depth, axis=axis, step=step if axis == "x" else step[::-1], inside=inside)
        sign = _growth(calibration, depth, axis)
        slope = sign * 2 * np.pi / period
        slopes = (slope, 0.0) if axis == "x" else (0.0, slope)
        decoder = Decoder(color, pattern.shifts, mosaic=mosaic, slopes=slopes, settings=settings)
        along = table.along.astype(np.float64)
        limits = table.limits.astype(np.float64)
        far, near = ((along[..., 0] + along[..., 1] * s) / (1 + along[..., 2] * s) for s in np.moveaxis(limits, -1, 0))
        phases = pattern.phase
        across_volume = np.abs(np.interp(near, np.arange(len(phases)), phases)
                               - np.interp(far, np.arange(len(phases)), phases))  # fmt: skip
        widest = float(across_volume.max()) / (2 * np.pi)
        return View(
            decoder, table, depth, packed(calibration.right), packed(calibration.projector), _even_table(pattern),
            np.ascontiguousarray(phases), slopes, int(widest) + 2,
            1 / max(widest, 1e-3), 0 if axis == "x" else 1, float(pattern.size[1] if axis == "x" else pattern.size[0]),
            settings,
        )  # fmt: skip

    def decode(self, image: NDArray[np.uint8]) -> PhaseMap:
        """Phase of this camera's picture."""
        return self.decoder.decode(image)

    def costs(
        self,
        here: PhaseMap,
        there: PhaseMap,
        correction: F64,
        labels: int,
        slopes: tuple[float, float],
        every: int = 1,
    ) -> tuple[Any, Any, Any]:
        """Costs, first orders and counts of the lattice's candidates (of every n-th row); slopes of the other view."""
        t, rows = self.table, slice(None, None, every)
        return candidates.candidate_costs(
            t.rows[rows], t.columns, t.along[rows], t.across[rows], t.other_u[rows], t.other_v[rows], t.limits[rows],
            here.phasor, here.equalized, here.mean, here.valid, here.phase, here.phase_eq,
            there.phasor, there.equalized, there.mean,
            self.columns, self.phases, correction, self.extent, labels,
            self.settings.min_modulation**2, self.settings.cost_sigma, self.settings.texture_weight, *slopes,
        )  # fmt: skip

    def decide(self, here: PhaseMap, costs: Any, first: Any, count: Any) -> NDArray[np.int16]:
        """Aggregate over the four paths and take the best order of each lattice pixel."""
        t, penalty = self.table, np.float32(self.settings.switch_penalty)
        total = np.zeros_like(costs)
        for vertical in (False, True):
            slope = self.slopes[1] if vertical else self.slopes[0]
            jump, trust = aggregate.links(here.phase, here.valid, t.rows, t.columns, slope, vertical)
            run = aggregate.along_columns if vertical else aggregate.along_rows
            run(costs, first, count, jump, trust, penalty, total)
        return np.asarray(aggregate.decide(total, first, count)[0])

    def cross_check(
        self, here: PhaseMap, order: Any, other: View, there: PhaseMap, other_order: Any, correction: F64
    ) -> Any:
        """Orders that the other view confirms."""
        t, o = self.table, other.table
        return propagate.cross_check(
            order, t.rows, t.columns, t.along, t.across, t.other_u, t.other_v, here.phase, here.phase_eq,
            other_order, o.rows, o.columns, there.phase, self.columns, correction, *other.slopes,
            self.settings.max_check,
        )  # fmt: skip

    def spread(self, here: PhaseMap, order: Any) -> NDArray[np.int16]:
        """Order of every pixel."""
        t = self.table
        return np.asarray(propagate.spread(order, t.rows, t.columns, here.phase, here.valid, *self.slopes))

    def column_differences(self, located: tuple[Any, ...], correction: F64) -> tuple[F64, F64, F64]:
        """Observed minus calibrated projector coordinate of located points (a subset), and where they are."""
        depth, _, _, source, residual = located
        some = np.zeros(depth.shape, bool)
        some[::3, ::2] = True
        some &= np.isfinite(depth) & (np.abs(residual[..., 0]) < 1.5)
        along = source[some][:, self.first_axis].astype(np.float64)
        across = source[some][:, 1 - self.first_axis].astype(np.float64)
        absolute = along + correction[0] + correction[1] * along + correction[2] * across
        rate = np.gradient(self.phases)
        difference = residual[some][:, 0] / np.interp(absolute, np.arange(len(rate)), rate)
        return absolute - along + difference, along, across


def _even_table(pattern: ColorFringe) -> F64:
    """(first phase, step, projector coordinates ...) on an even grid of phases, half a pixel beyond both ends."""
    phases = pattern.phase
    lowest = phases[0] - 0.5 * (phases[1] - phases[0])
    highest = phases[-1] + 0.5 * (phases[-1] - phases[-2])
    n = 2 * len(phases) if pattern.profile is None else 16 * len(phases)
    grid = np.linspace(lowest, highest, n)
    return np.concatenate([[lowest, grid[1] - grid[0]], pattern.column_of(grid)])


def _growth(calibration: Calibration, depth: DepthScale, axis: str) -> float:
    """+1 when the phase grows with u (or v) in this camera's picture, else -1."""
    width, height = calibration.left.size
    first = 0 if axis == "x" else 1
    centre = np.array([[width / 2, height / 2], [width / 2, height / 2]])
    centre[1, first] += 4.0
    rays = np.concatenate([calibration.left.normalise(centre), np.ones((2, 1))], axis=1)
    columns = calibration.projector.project(rays * depth.depth(0.5))[:, first]
    return 1.0 if columns[1] > columns[0] else -1.0
