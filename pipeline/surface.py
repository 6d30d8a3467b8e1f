"""From the orders to the cloud: match and locate, the gates, and the cloud's own arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.assemble import assemble
from pipeline.calibration import Calibration
from pipeline.cloud import Cloud
from pipeline.gates import Gates
from pipeline.located import Located
from pipeline.packed import PHASOR_SCALE
from pipeline.phase import PhaseMap
from pipeline.refine import refine
from pipeline.settings import Settings
from pipeline.stopwatch import Stopwatch
from pipeline.view import View


class SurfaceStage:
    """For one calibration and one resolution, in arrays that every pair uses again.

    Args:
        left: the left camera's view; correlation: of neighbouring phases' noise in the right picture.
        every: step of the pixels that get points, in both directions.
    """

    def __init__(
        self, calibration: Calibration, left: View, settings: Settings, correlation: float, *, every: int
    ) -> None:
        self._view, self._every = left, every
        rays = calibration.left.rays()[::every, ::every].astype(np.float32)
        self._rays_x, self._rays_y = np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])
        shape = self._rays_x.shape
        self._located = Located.empty(shape)
        self._floor_sq, self._correlation = (
            np.float32((settings.min_modulation * PHASOR_SCALE) ** 2),
            np.float32(correlation),
        )
        self._gates = Gates(
            shape, calibration.right.size, calibration.projector.size, (every * left.slopes[0], every * left.slopes[1]),
            left.depth, left.order_step, settings, smallest=max(settings.min_component // every**2, 1),
        )  # fmt: skip

    def locate(self, left: PhaseMap, right: PhaseMap, order: Any, correction: NDArray[np.float64]) -> Located:
        """Points of the pixels of this resolution, valid until the next call; ``left``, ``order`` hold only those."""
        v = self._view
        refine(
            order, self._rays_x, self._rays_y, left.phase, left.equalized, left.phasor, left.variance,
            right.phasor, right.variance, v.other, v.projector, v.first_axis,
            np.float32(v.depth.base), np.float32(v.depth.span), v.columns, v.phases, v.linear,
            correction.astype(np.float32), self._floor_sq, self._correlation, *self._located,
        )  # fmt: skip
        return self._located

    def cloud(
        self,
        left: PhaseMap,
        right: PhaseMap,
        order: Any,
        correction: NDArray[np.float64],
        watch: Stopwatch,
        *,
        confirm: Callable[[Located], None] | None = None,
    ) -> Cloud:
        """The cloud on the left camera's whole pixel grid; ``left`` and ``order`` are of full resolution.

        ``confirm`` may forget points before the gates look at them.
        """
        part, some = (left, order) if self._every == 1 else (left.every(self._every), _every(order, self._every))
        located = self.locate(part, right, some, correction)
        if confirm is not None:
            confirm(located)
        watch.lap("refinement")
        known = self._gates.certain(located, part.modulation)
        watch.lap("gates")
        xyz, sigma, gray, kept = assemble(
            known, located.depth_mm, located.sigma_mm, self._rays_x, self._rays_y, left.mean, some, self._every
        )
        cloud = Cloud(
            xyz=xyz,
            sigma_mm=sigma,
            gray=gray,
            modulation=(left.modulation, right.modulation),
            order=kept,
            saturated=(left.clipped, right.clipped),
            ms=watch.ms,
        )
        watch.lap("output")
        return cloud


def _every(plane: NDArray[Any], step: int) -> NDArray[Any]:
    return np.ascontiguousarray(plane[::step, ::step])
