"""From fringe orders to the cloud: sub-pixel match, point filter, and the cloud's own arrays."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.decode.decoder import PhaseMap
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.filter.mask_rejected import mask_rejected
from pipeline.filter.point_filter import Gates
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import MatchResult, Points
from pipeline.match.subpixel_match import refine
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.calibration import Calibration


class CloudStage:
    """Makes clouds of one calibration and one resolution, in arrays that every pair reuses.

    Args:
        left: the left camera's view; correlation: of neighbouring phases' noise in the right image.
        stride: step of the pixels that get points, in both directions.
    """

    def __init__(
        self, calibration: Calibration, left: View, settings: Settings, correlation: float, *, stride: int
    ) -> None:
        self._view, self._stride = left, stride
        self._size = calibration.left.size[::-1]
        rays = calibration.left.rays()[::stride, ::stride].astype(np.float32)
        self._rays_x, self._rays_y = np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])
        shape = self._rays_x.shape
        self._match = MatchResult.empty(shape)
        self._floor_sq = np.float32((settings.min_modulation * PHASOR_SCALE) ** 2)
        self._correlation = np.float32(correlation)
        self._gates = Gates(
            shape, calibration.right.size, calibration.projector.size,
            (stride * left.slopes[0], stride * left.slopes[1]), left.depth, left.order_step, settings,
            smallest=max(settings.min_component // stride**2, 1),
        )  # fmt: skip

    def match(
        self, left: PhaseMap, right: PhaseMap, order: Any, correction: NDArray[np.float64], points: Points | None = None
    ) -> MatchResult:
        """Match the pixels of this resolution; ``left`` and ``order`` hold only those. Valid until the next call.

        The points themselves go into ``points``, of the full resolution, if that is given.
        """
        v = self._view
        points = points or Points.empty(self._size)
        refine(
            order, self._rays_x, self._rays_y, left.phase, left.descriptors, left.phasor, left.variance,
            right.phasor, right.variance, v.other, v.projector, v.first_axis,
            np.float32(v.depth.base), np.float32(v.depth.span), v.phase_to_column, v.column_to_phase, v.linear,
            correction.astype(np.float32), self._floor_sq, self._correlation, self._stride,
            points.xyz, points.sigma_mm, *self._match,
        )  # fmt: skip
        return self._match

    def cloud(
        self,
        left: PhaseMap,
        right: PhaseMap,
        order: Any,
        correction: NDArray[np.float64],
        watch: Stopwatch,
        *,
        confirm: Callable[[MatchResult], None] | None = None,
    ) -> Cloud:
        """The cloud on the left camera's whole pixel grid; ``left`` and ``order`` are of full resolution.

        ``confirm`` may reject points before the point filter.
        """
        part, part_order = left, order
        if self._stride > 1:
            part = left.subsampled(self._stride)
            part_order = np.ascontiguousarray(order[:: self._stride, :: self._stride])
        points = Points.empty(self._size)
        match = self.match(part, right, part_order, correction, points)
        if confirm is not None:
            confirm(match)
        watch.lap("refinement")
        valid = self._gates.certain(match, points.depth_mm(self._stride), part.modulation)
        watch.lap("gates")
        kept = np.empty(self._size, np.int16)
        mask_rejected(valid, part_order, self._stride, points.xyz, points.sigma_mm, kept)
        cloud = Cloud(
            xyz=points.xyz,
            sigma_mm=points.sigma_mm,
            gray=left.mean,
            modulation=(left.modulation, right.modulation),
            order=kept,
            saturated=(left.saturated, right.saturated),
            ms=watch.ms,
        )
        watch.lap("output")
        return cloud
