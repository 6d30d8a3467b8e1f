"""What is not certain is unknown: local agreement, connected surfaces, and uniqueness in the other two devices."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.common.parallel_for import blocks
from pipeline.common.settings import Settings
from pipeline.decode.decoder import PhaseMap
from pipeline.filter.border.border_figures import Planes
from pipeline.filter.border.border_model import MODEL
from pipeline.filter.border.border_pixels import ROWS as BORDER_ROWS
from pipeline.filter.border.border_test import CODES, border_test, code_of, largest_code
from pipeline.filter.border.surface_edges import ROWS as EDGE_ROWS
from pipeline.filter.border.surface_edges import edge_test
from pipeline.filter.local_outliers import MOST_MEAN, ROWS, drop_mixed_edges, local_outliers, usual_residuals
from pipeline.filter.occlusion.occlusion_conflicts import PARAMETER_STEPS, Values
from pipeline.filter.occlusion.uniqueness import Uniqueness
from pipeline.filter.surfaces import surface_links
from pipeline.filter.surfaces.brightness_edges import DividedSurfaces
from pipeline.filter.surfaces.component_test import component_test, rms_of
from pipeline.filter.surfaces.continued_orders import continued_orders
from pipeline.filter.surfaces.small_surfaces import reject_contradicted, reject_eroded
from pipeline.filter.surfaces.surface_evidence import DISTINCT, Figures
from pipeline.filter.surfaces.unconfirmed_surfaces import (
    LEAST_OPEN,
    reject_open,
    reject_parts,
    reject_unconfirmed,
    usual_rms,
)
from pipeline.filter.surfaces.unexplained_regions import UnexplainedRegions
from pipeline.filter.texture_agreement import DEVIATION_STEPS, LOSS, MISFIT_STEPS, Agreement, Scale
from pipeline.fringe_order.margins.order_margins import MOST_REJECTED, VAGUE_SHARE, Continued
from pipeline.fringe_order.margins.sampled_groups import Ambiguous
from pipeline.geometry.ray_tables import DepthScale
from pipeline.match.match_result import LARGEST_RESIDUAL, RESIDUAL_STEP, TURN_STEPS, MatchResult, Points

LARGEST_MEAN_RAD, TIMES_USUAL = 0.18, 5
"""Mean residual of a neighbourhood from which its points are rejected: textures cause less, strips that only one camera
sees and that are matched to the surface before them have 0.2 to 0.4 and err by millimetres. The second: how many times
the median of the image it is at least, since the means of a projector with an inexact calibration are large everywhere.
"""
_SMALLER_PARTS = 4
"""How many times smaller than the smallest surface a part of one is whose orders are judged."""
_DISTINCT_TURNS = 0.2
"""Turns of the projector's phase that a wrong order leaves, from which it is taken to show everywhere."""
LARGE_SHARE = 0.01
"""Share of the image from which a surface's texture is not tested as a whole."""
HIGH = 3 * DEVIATION_STEPS
"""Deviation of the texture from which a pixel inside a surface is tested as one at its edge."""
EDGE_LOSS, LOSS_PER_NEIGHBOUR = 2.9, 0.3
"""Largest mean loss around an edge pixel with all its neighbours, and how much less for each that lacks."""
EDGE_MISFIT_RAD = (0.9, 0.9, 0.9, 0.9, 0.8, 0.7, 0.5, 0.3, 0.1)
"""Phase error of an edge pixel by the number of its neighbours that belong to the surface, radians."""
MISFIT_OF = np.rint(np.array(EDGE_MISFIT_RAD) * MISFIT_STEPS).astype(np.uint8)
_LOSS = LOSS.astype(np.float32)


RejectAmbiguous = Callable[[NDArray[np.uint16], NDArray[np.int32], Continued, NDArray[np.uint8]], Ambiguous]
"""Rejects surfaces whose fringe orders do not win clearly: of label (H, W), sizes (n,) and continued orders (n,), in
``valid`` (H, W). See :mod:`pipeline.fringe_order.margins.order_margins`."""


class Gates:
    """The gates for one image size, in arrays that every call uses again.

    Args:
        shape: (H, W) of the left camera's image; right, projector: (width, height) of the other devices.
        slopes: expected phase steps per pixel of the left image (x, y), radians.
        depth: scale of the parameter s; order_step: change of s from one order to the next.
        smallest: pixels of the smallest connected surface.
        phase_weight: 0..1, how far the projector's phase distinguishes fringe orders, see :func:`phase_weight`.
        stride: step of these pixels in the cloud's planes.
    """

    def __init__(
        self, shape: tuple[int, int], right: tuple[int, int], projector: tuple[int, int],
        slopes: tuple[float, float], depth: DepthScale, order_step: float, settings: Settings, *, smallest: int,
        phase_weight: float = 1.0, stride: int = 1,
    ) -> None:  # fmt: skip
        self._right, self._projector, self._settings, self._smallest = right, projector, settings, smallest
        self._phase_weight, self._stride = phase_weight, stride
        self._most = code_of(settings.edge_probability)
        #: Change of 1 / z from one fringe order to the next, 1 / mm.
        self.per_order = np.float32(abs(depth.span * order_step))
        self._slopes = round(slopes[0] / (2 * np.pi) * TURN_STEPS), round(slopes[1] / (2 * np.pi) * TURN_STEPS)
        self._base, self._span = np.float32(depth.base), np.float32(depth.span)
        self._tolerance = int(order_step / 4 * PARAMETER_STEPS)
        self._valid, self._before, self._link = (np.empty(shape, np.uint8) for _ in range(3))
        self._large = max(20 * self._smallest, int(LARGE_SHARE * self._valid.size))
        self._label, self._code = np.empty(shape, np.uint16), np.empty(shape, np.uint8)
        self._expected = np.empty((blocks(shape[0], BORDER_ROWS), CODES))
        self._surfaces, self._divided = Surfaces(shape), DividedSurfaces(shape)
        self._regions = UnexplainedRegions(shape)
        self._unique = Uniqueness(shape, (right, projector))

    def certain(
        self, match: MatchResult, points: Points, left: PhaseMap, agreement: Agreement, scale: Scale,
        reject_ambiguous: RejectAmbiguous | None = None,
    ) -> NDArray[np.uint8]:  # fmt: skip
        """1 where a point is certain, else 0, (H, W); valid until the next call.

        Args:
            match: of the left image; points: their sigma is raised at the borders of surfaces.
            left: of the same pixels.
            agreement: of the textures; scale: of their differences.
            reject_ambiguous: without it, fringe orders are not tested.
        """
        depth_mm, modulation, mean = points.depth_mm(self._stride), left.modulation, left.mean
        s, valid, label, surfaces = self._settings, self._valid, self._label, self._surfaces
        bands = blocks(len(valid), ROWS)
        limit, largest = _steps(s.outlier_phase_threshold), _steps(s.reflection_threshold)
        usual, square = usual_residuals(match)
        far = max(_steps(LARGEST_MEAN_RAD), min(TIMES_USUAL * usual, MOST_MEAN))
        local_outliers(bands, match.valid, match.residual_normalised, match.residual, limit, largest, far, valid)
        surface_links.links(
            len(valid),
            match.absolute_phase,
            match.right_u.view(np.int16),
            match.right_v.view(np.int16),
            *self._slopes,
            self._link,
        )
        surfaces.find(valid, self._link, self._smallest)
        surfaces.paint(label)
        drop_mixed_edges(bands, label, modulation, np.float32(s.edge_threshold), valid)
        self._test_components(match, agreement, mean, scale)
        np.copyto(self._before, valid)
        edge_test(
            blocks(len(label), EDGE_ROWS), label, agreement.deviation, _LOSS, HIGH, np.float32(EDGE_LOSS),
            np.float32(LOSS_PER_NEIGHBOUR), MISFIT_OF, match.residual_normalised, match.residual,
            square if self._phase_weight >= DISTINCT else 0, agreement.misfit, valid,
        )  # fmt: skip
        by_phase = Values(match.absolute_phase, False, self._base, self._span)
        for u, v, device, values, tolerance in (
            (match.right_u, match.right_v, self._right, by_phase, int(1.5 / (2 * np.pi) * TURN_STEPS)),
            (match.projector_u, match.projector_v, self._projector, by_phase._replace(by_depth=True), self._tolerance),
        ):
            self._unique.apply(
                valid, label, surfaces.sizes, u, v, depth_mm, device, values, tolerance, 4 * self._smallest
            )
        surfaces.find(valid, self._link, self._smallest)
        reject_contradicted(self._before, valid, label, surfaces, self._large, self._stride)
        figures = self._test_components(match, agreement, mean, scale)
        surfaces.paint(label)
        if reject_ambiguous is not None:
            if self._phase_weight < DISTINCT:
                self._reject_ambiguous_parts(match, left, reject_ambiguous)
            continued = continued_orders(match, left, label, surfaces, self._large, match.valid)
            found = reject_ambiguous(label, surfaces.sizes, continued, valid)
            if self._phase_weight >= DISTINCT and found.kept * surfaces.sizes.sum() > VAGUE_SHARE * self._large:
                self._reject_ambiguous_walls(left, reject_ambiguous)
        continued = continued_orders(match, left, label, surfaces, self._large, valid)
        self._regions.reject_remains(
            left.valid, valid, label, surfaces, figures, continued, scale.matched_loss, self._large
        )
        reject_unconfirmed(figures, continued, scale.matched_loss, surfaces, self._large, valid)
        self._reject_unconfirmed_parts(match, left, agreement, usual_rms(figures, surfaces.sizes, self._large))
        planes = Planes(
            label, agreement.deviation, agreement.misfit, match.right_u, match.residual_normalised, match.residual,
            mean, *points,
        )  # fmt: skip
        border_test(
            len(self._expected), planes, _LOSS, self._stride, self.per_order, MODEL, valid, agreement.misfit,
            points.sigma_mm, self._code, self._expected,
        )  # fmt: skip
        most = largest_code(self._expected, int(np.count_nonzero(valid)), self._most)
        valid &= np.less_equal(self._code, most, out=self._before.view(np.bool_)).view(np.uint8)
        reject_eroded(valid, surfaces, self._smallest)
        return valid

    def _reject_ambiguous_parts(self, match: MatchResult, left: PhaseMap, reject_ambiguous: RejectAmbiguous) -> None:
        """Judge the orders of surfaces' parts between edges of the brightness, as those of surfaces."""
        parts, valid = self._divided, self._valid
        parts.find(valid, left.mean, self._link, max(self._smallest // _SMALLER_PARTS, 1))
        continued = continued_orders(match, left, parts.label, parts.surfaces, self._large, match.valid)
        if reject_ambiguous(parts.label, parts.surfaces.sizes, continued, valid).rejected > MOST_REJECTED:
            continued = continued_orders(match, left, parts.label, parts.surfaces, self._large, valid)
            reject_open(continued, parts.surfaces, self._large, valid)

    def _reject_ambiguous_walls(self, left: PhaseMap, reject_ambiguous: RejectAmbiguous) -> None:
        """Judge the orders of large parts of surfaces between edges of the brightness, as those of surfaces.

        Where fewer pixels of surfaces are ambiguous than make the smallest large part so, none can be rejected.
        """
        parts = self._divided
        parts.find(self._valid, left.mean, self._link, self._large)
        sizes = parts.surfaces.sizes
        reject_ambiguous(parts.label, sizes, Continued.none(len(sizes)), self._valid)

    def _reject_unconfirmed_parts(
        self, match: MatchResult, left: PhaseMap, agreement: Agreement, usual: float
    ) -> None:  # fmt: skip
        """Reject small parts of surfaces between edges of the brightness that nothing beside them confirms."""
        parts, valid = self._divided, self._valid
        parts.find(valid, left.mean, self._link, self._smallest)
        continued = continued_orders(match, left, parts.label, parts.surfaces, self._large, valid)
        if not (continued.open >= LEAST_OPEN).any():
            return
        rms = rms_of(valid, match, agreement.deviation, parts.surfaces, self._large)
        reject_parts(parts, rms, usual, continued, self._label, self._surfaces.sizes, self._large, valid)

    def _test_components(self, match: MatchResult, agreement: Agreement, mean: Any, scale: Scale) -> Figures:
        return component_test(
            self._valid, match, agreement.deviation, mean, self._surfaces, self._large, scale,
            self._settings.cluster_phase_threshold, self._phase_weight, self._stride,
        )  # fmt: skip


def _steps(residual: float) -> int:
    return min(round(residual / RESIDUAL_STEP), LARGEST_RESIDUAL)


def phase_weight(baselines: float, phases: NDArray[np.float32], *, linear: bool) -> float:
    """How far a fringe order that is wrong by one shows in the projector's phase, 0..1.

    On a plane, an order that moves the projector's column by d leaves the difference of the phases at the column itself
    and at ``baselines`` d from it: of equal fringes ``frac(baselines)`` turns, nothing where that is a whole number; of
    frequency-modulated ones, there, their second difference, which is zero at many columns. Their median counts.

    Args:
        baselines: ratio of the baselines left to right and left to projector.
        phases: (n,) of the projector's columns, increasing; linear: the fringes are equal.
    """
    if linear:
        return min(1.0, abs(baselines - round(baselines)) / _DISTINCT_TURNS)
    columns, phase = np.arange(len(phases), dtype=np.float64), np.asarray(phases, np.float64)
    turns = []
    for order in (-2 * np.pi, 2 * np.pi):
        moved = columns + baselines * (np.interp(phase + order, phase, columns, np.nan, np.nan) - columns)
        turns.append((np.interp(moved, columns, phase, np.nan, np.nan) - phase) / (2 * np.pi))
    known = np.concatenate(turns)
    known = known[np.isfinite(known)]
    return min(1.0, float(np.median(np.abs(known - np.round(known)))) / _DISTINCT_TURNS) if len(known) else 0.0
