"""From fringe orders to the cloud: sub-pixel match, point filter, and the cloud's own arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import blocks
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.decode.decoder import PhaseMap
from pipeline.decode.packed_phasor import PHASOR_SCALE
from pipeline.filter.blurred_steps import least_step
from pipeline.filter.depth_bends import DepthSteps, bends_of, widen_at_bends
from pipeline.filter.depth_clusters import Clusters, largest_step
from pipeline.filter.mask_rejected import mask_rejected, mask_unknown
from pipeline.filter.point_filter import Gates, phase_weight
from pipeline.filter.sigma_terms import ROWS as SIGMA_ROWS
from pipeline.filter.sigma_terms import shares_of, widen_sigma
from pipeline.filter.texture_agreement import Agreement, Scale, compare, scale_and_inside, scales_of
from pipeline.fringe_order.margins.order_margins import Continued
from pipeline.fringe_order.margins.sampled_groups import Ambiguous
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import MatchResult, Points
from pipeline.match.subpixel_match import ROWS, refine
from pipeline.match.tile_match import MatchModel
from pipeline.reconstruct import neighbour_match
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.neighbour_match import LeftImage, RightImage, match_neighbours
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_TOLERANCE = 0.02
_SEARCHED = np.float32(-_TOLERANCE), np.float32(1 + _TOLERANCE)
RejectByOrders = Callable[
    [NDArray[np.int16], int, NDArray[np.uint16], NDArray[np.int32], Continued, NDArray[np.uint8]], Ambiguous
]


class CertainPoints(NamedTuple):
    """Points of the pixels of one resolution: phases, orders, match, points, and 1 where they are certain, else 0."""

    part: PhaseMap
    order: Any
    match: MatchResult
    points: Points
    valid: NDArray[np.uint8]


class CloudStage:
    """Makes clouds of one calibration and one resolution, in arrays that every pair reuses.

    Args:
        volume: in which there are points, plus 2 %; left: the left camera's view.
        correlation: of neighbouring phases' noise in the right image.
        mosaic: whether the sensors are mosaics.
        stride: step of the pixels that get points, in both directions.
    """

    def __init__(
        self, calibration: Calibration, volume: Volume, left: View, settings: Settings, correlation: float, *,
        stride: int, mosaic: bool = False,
    ) -> None:  # fmt: skip
        self._view, self._stride, self._mosaic = left, stride, mosaic
        least, most = left.depth.range_of(volume, _TOLERANCE)
        near, far = (np.float32(1 / (left.depth.base + s * left.depth.span)) for s in (most, least))
        self._depths = near, far
        self._size, self._right_size = calibration.left.size[::-1], calibration.right.size
        rays = calibration.left.rays()[::stride, ::stride].astype(np.float32)
        self._rays_x, self._rays_y = np.ascontiguousarray(rays[..., 0]), np.ascontiguousarray(rays[..., 1])
        shape = self._rays_x.shape
        self._match = MatchResult.empty(shape)
        self._floor_sq = np.float32((settings.min_modulation * PHASOR_SCALE) ** 2)
        self._correlation = np.float32(correlation)
        self.contrast = 1.0  # of the right camera's fringes, relative to the left one's
        self.uneven = False  # the means of the right image are corrected over the image
        self.corrected_scatter = 0.0  # of the phases against the projector's, rad^2
        self._slopes = stride * left.slopes[0], stride * left.slopes[1]
        smallest = max(settings.cluster_min_area // stride**2, 1)
        self._gates = Gates(
            shape, calibration.right.size, calibration.projector.size,
            self._slopes, left.depth, left.order_step, settings, smallest=smallest,
            phase_weight=phase_weight(baselines(calibration), left.column_to_phase, linear=left.linear), stride=stride,
        )  # fmt: skip
        self._agreement, self._bends = Agreement.empty(shape), bends_of(shape)
        self._clusters = Clusters(shape, smallest, stride)
        fx, fy = calibration.left.matrix[0, 0], calibration.left.matrix[1, 1]
        self._steps = DepthSteps(
            (least_step(fx, stride), least_step(fy, stride)), (largest_step(fx, stride), largest_step(fy, stride))
        )
        self._slope = np.float32(self._slopes[0])

    def match(
        self, left: PhaseMap, right: PhaseMap, order: Any, correction: NDArray[np.float64],
        points: Points | None = None,
    ) -> MatchResult:  # fmt: skip
        """Match the pixels of this resolution; ``left`` and ``order`` hold only those. Valid until the next call.

        The points themselves go into ``points``, of the full resolution, if that is given. Surfaces outside of the
        volume are matched too, as far as orders are searched.
        """
        points = points or Points.empty(self._size)
        refine(
            blocks(len(order), ROWS), order, self._rays_x, self._rays_y, left.phase, left.descriptors, left.phasor,
            left.variance, right.phasor, right.variance, self._model(correction), self._stride, *points, *self._match,
        )  # fmt: skip
        return self._match

    def _model(self, correction: NDArray[np.float64]) -> MatchModel:
        v = self._view
        return MatchModel(
            v.other, *self._right_size, v.projector, v.first_axis, np.float32(v.depth.base), np.float32(v.depth.span),
            *_SEARCHED, v.phase_to_column, v.column_to_phase, v.linear, correction.astype(np.float32),
            self._floor_sq, self._correlation, np.float32(1 / self.contrast - 1),
        )  # fmt: skip

    def match_neighbours(
        self, left: PhaseMap, right: PhaseMap, order: Any, scale: Scale, inside: Scale,
        correction: NDArray[np.float64], points: Points,
    ) -> None:  # fmt: skip
        """Match pixels that agree badly or not at all with the orders of surfaces beside them, where that agrees."""
        match_neighbours(
            blocks(len(order), neighbour_match.ROWS), order,
            LeftImage(
                self._rays_x, self._rays_y, left.phase, left.descriptors, left.phasor, left.variance, left.mean,
                left.modulation, left.valid,
            ),
            RightImage(*(p.reshape(-1) for p in (right.phasor, right.variance, right.mean, right.modulation))),
            self._model(correction), scales_of(scale, inside), self._slope, self._stride, *points, *self._match,
            *self._agreement,
        )  # fmt: skip

    def cloud(
        self,
        left: PhaseMap,
        right: PhaseMap,
        order: Any,
        correction: NDArray[np.float64],
        watch: Stopwatch,
        *,
        confirm: Callable[[MatchResult], None] | None = None,
        reject_ambiguous: RejectByOrders | None = None,
    ) -> Cloud:
        """The cloud on the left camera's whole pixel grid; ``left`` and ``order`` are of full resolution.

        Args:
            confirm: may reject points before the point filter; then no other orders are tried.
            reject_ambiguous: as of the point filter, with fringe orders and stride before; None: no such test.
        """
        certain = self.certain(
            left, right, order, correction, watch, confirm=confirm, reject_ambiguous=reject_ambiguous
        )  # fmt: skip
        return self.finish(left, right, certain, watch)

    def certain(
        self, left: PhaseMap, right: PhaseMap, order: Any, correction: NDArray[np.float64], watch: Stopwatch, *,
        confirm: Callable[[MatchResult], None] | None = None, reject_ambiguous: RejectByOrders | None = None,
    ) -> CertainPoints:  # fmt: skip
        """Points, and which of them are certain; arguments as of :meth:`cloud`. Valid until the next call."""
        part, part_order = left, order
        if self._stride > 1:
            part = left.subsampled(self._stride)
            part_order = np.ascontiguousarray(order[:: self._stride, :: self._stride])
        if self.uneven:
            right = right.with_corrected_mean()
        points = Points.empty(self._size)
        match = self.match(part, right, part_order, correction, points)
        if confirm is not None:
            confirm(match)
        watch.lap("refinement")
        scale, inside = scale_and_inside(match, part, right, points.depth_mm(self._stride), self._depths)
        compare(match, part, right, scale, inside, self._agreement)
        if confirm is None:
            self.match_neighbours(part, right, part_order, scale, inside, correction, points)
        watch.lap("agreement")
        by_orders = None if reject_ambiguous is None else partial(reject_ambiguous, part_order, self._stride)
        valid = self._gates.certain(match, points, part, self._agreement, scale, by_orders)
        watch.lap("gates")
        return CertainPoints(part, part_order, match, points, valid)

    def finish(self, left: PhaseMap, right: PhaseMap, certain: CertainPoints, watch: Stopwatch) -> Cloud:
        """The cloud of certain points inside the volume with their standard deviations; ``left``: all its pixels."""
        part, part_order, match, points, valid = certain
        shares = shares_of(
            match, part.variance, points.depth_mm(self._stride), self._depths, slopes=self._slopes,
            mosaic=self._mosaic, saturated=left.saturated, corrected=self.corrected_scatter,
        )  # fmt: skip
        widen_sigma(
            blocks(len(valid), SIGMA_ROWS), self._agreement.misfit, match, part.variance, shares, self._slopes,
            self._stride, points.sigma_mm,
        )  # fmt: skip
        kept = np.empty(self._size, np.int16)
        # Only now: surfaces beyond the volume compete for the pixels of the right camera with false ones inside it.
        mask_rejected(len(kept), valid, part_order, self._stride, *self._depths, points.xyz, points.sigma_mm, kept)
        clusters = self._clusters
        widen_at_bends(
            self._stride, self._gates.per_order, self._steps, points.xyz, points.sigma_mm, self._bends, clusters.known,
            clusters.link,
        )  # fmt: skip
        clusters.reject_small()
        mask_unknown(len(clusters.known), clusters.known, self._stride, points.xyz, points.sigma_mm, kept)
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


def baselines(calibration: Calibration) -> float:
    """Ratio of the baselines left to right and left to projector, along the former."""
    left, right, projector = (
        -device.rotation.T @ device.translation
        for device in (calibration.left, calibration.right, calibration.projector)
    )
    across = right - left
    share = float((projector - left) @ across / (across @ across))
    return 1 / share if abs(share) > 1e-6 else 0.5
