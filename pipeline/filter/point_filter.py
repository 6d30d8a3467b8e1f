"""What is not certain is unknown: local agreement, connected surfaces, and uniqueness in the other two devices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import parallel, prange
from pipeline.common.settings import Settings
from pipeline.filter import connected_components
from pipeline.filter.connected_components import Surfaces
from pipeline.filter.local_outliers import drop_mixed_edges, local_outliers
from pipeline.filter.occlusion_conflicts import PARAMETER_STEPS, Values
from pipeline.filter.uniqueness import PARTS, Uniqueness
from pipeline.geometry.ray_tables import DepthScale
from pipeline.match.match_result import LARGEST_RESIDUAL, RESIDUAL_STEP, TURN_STEPS, MatchResult

_NO = np.uint8(0)


@parallel
def _squares(
    valid: Any, first: Any, second: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, size: Any,
    small: int, total: Any,
) -> None:  # fmt: skip
    """Sums of squared residuals of the surfaces that are not large, (PARTS, surfaces) int64, by bands of rows."""
    height = valid.shape[0]
    parts = total.shape[0]
    for part in prange(parts):
        for i in range(part * height // parts, (part + 1) * height // parts):
            for t in range(count[0, i]):
                k = surface[row[i] + t]
                if k < 0 or size[k] >= small:
                    continue
                for j in range(start[i, t], stop[i, t]):
                    a, b = np.int64(first[i, j]), np.int64(second[i, j])
                    total[part, k] += min(a * a, b * b) if valid[i, j] != 0 else 0


@parallel
def _forget(doubtful: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, valid: Any) -> None:
    """Reject the runs of no surface and of doubtful ones."""
    for i in prange(valid.shape[0]):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k < 0 or doubtful[k]:
                valid[i, start[i, t] : stop[i, t]] = _NO


class Gates:
    """The gates for one image size, in arrays that every call uses again.

    Args:
        shape: (H, W) of the left camera's image; right, projector: (width, height) of the other devices.
        slopes: expected phase steps per pixel of the left image (x, y), radians.
        depth: scale of the parameter s; order_step: change of s from one order to the next.
        smallest: pixels of the smallest connected surface.
    """

    def __init__(
        self, shape: tuple[int, int], right: tuple[int, int], projector: tuple[int, int],
        slopes: tuple[float, float], depth: DepthScale, order_step: float, settings: Settings, *, smallest: int,
    ) -> None:  # fmt: skip
        self._right, self._projector, self._settings, self._smallest = right, projector, settings, smallest
        self._slopes = round(slopes[0] / (2 * np.pi) * TURN_STEPS), round(slopes[1] / (2 * np.pi) * TURN_STEPS)
        self._base, self._span = np.float32(depth.base), np.float32(depth.span)
        self._tolerance = int(order_step / 4 * PARAMETER_STEPS)
        self._valid, self._link = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        self._label = np.empty(shape, np.uint16)
        self._surfaces = Surfaces(shape)
        self._unique = Uniqueness(shape, (right, projector))

    def certain(self, match: MatchResult, depth_mm: Any, modulation: Any) -> NDArray[np.uint8]:
        """1 where a point is certain, else 0, (H, W); valid until the next call.

        Args:
            match: of the left image; depth_mm: (H, W), float32; modulation: (H, W) uint8, counts.
        """
        s, valid, label, surfaces = self._settings, self._valid, self._label, self._surfaces
        limit, largest = _steps(s.max_residual), _steps(s.max_phase_error)
        local_outliers(match.valid, match.residual_normalised, match.residual, limit, largest, valid)
        connected_components.links(
            match.absolute_phase, match.right_u.view(np.int16), match.right_v.view(np.int16), *self._slopes, self._link
        )
        surfaces.find(valid, self._link, self._smallest)
        surfaces.paint(label)
        drop_mixed_edges(label, modulation, np.float32(s.edge_modulation), valid)
        self._drop_doubtful(match)
        by_phase = Values(match.absolute_phase, False, self._base, self._span)
        for u, v, device, values, tolerance in (
            (match.right_u, match.right_v, self._right, by_phase, int(1.5 / (2 * np.pi) * TURN_STEPS)),
            (match.projector_u, match.projector_v, self._projector, by_phase._replace(by_depth=True), self._tolerance),
        ):
            self._unique.apply(
                valid, label, surfaces.sizes, u, v, depth_mm, device, values, tolerance, 4 * self._smallest
            )
        surfaces.find(valid, self._link, self._smallest)
        self._drop_doubtful(match)
        return valid

    def _drop_doubtful(self, match: MatchResult) -> None:
        """Reject what belongs to no surface, and surfaces that are not large and off the projector's phase as a whole.

        A false match agrees in left and right phase by construction, but not with the projector.
        """
        f = self._surfaces
        small, sizes = 20 * self._smallest, f.sizes
        total = np.zeros((PARTS, len(sizes)), np.int64)
        _squares(
            self._valid, match.residual_normalised, match.residual, f.start, f.stop, f.count, f.first, f.surface, sizes,
            small, total,
        )  # fmt: skip
        largest = (self._settings.max_surface_error / RESIDUAL_STEP) ** 2
        doubtful = (sizes < small) & (total.sum(axis=0) > largest * sizes)
        _forget(doubtful, f.start, f.stop, f.count, f.first, f.surface, self._valid)


def _steps(residual: float) -> int:
    return min(round(residual / RESIDUAL_STEP), LARGEST_RESIDUAL)
