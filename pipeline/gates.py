"""What is not certain is unknown: local agreement, connected surfaces, and uniqueness in the other two devices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline import components, rivals
from pipeline.components import Surfaces
from pipeline.kernels import serial
from pipeline.located import Located
from pipeline.outliers import drop_mixed_edges, local_outliers
from pipeline.settings import Settings
from pipeline.tables import DepthScale
from pipeline.uniqueness import Uniqueness

_NO = np.uint8(0)


@serial
def drop_doubtful(
    known: Any, first: Any, second: Any, start: Any, stop: Any, count: Any, row: Any, surface: Any, size: Any,
    small: int, largest_rms: Any,
) -> None:  # fmt: skip
    """Forget what belongs to no surface, and surfaces that are not large and off the projector's phase as a whole.

    A ghost agrees in left and right phase by construction but has no reason to agree with the projector.

    Args:
        known: (H, W) uint8, changed; first, second: (H, W) float32 residuals, radians.
        start, stop, count, row, surface, size: runs and surfaces, see :class:`pipeline.components.Surfaces`.
        small: pixels from which a surface is large; largest_rms: float32, radians.
    """
    height = known.shape[0]
    total = np.zeros(size.shape[0], np.float32)
    for i in range(height):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k < 0 or size[k] >= small:
                continue
            square = np.float32(0.0)
            for j in range(start[i, t], stop[i, t]):
                if known[i, j]:
                    a, b = first[i, j], second[i, j]
                    square += min(a * a, b * b)
            total[k] += square
    for i in range(height):
        for t in range(count[0, i]):
            k = surface[row[i] + t]
            if k < 0 or (size[k] < small and total[k] > largest_rms * largest_rms * size[k]):
                known[i, start[i, t] : stop[i, t]] = _NO


class Gates:
    """The gates for one picture size, in arrays that every call uses again.

    Args:
        shape: (H, W) of the left camera's picture; right, projector: (width, height) of the other devices.
        slopes: expected phase steps per pixel of the left picture (x, y), radians.
        depth: scale of the parameter s; order_step: change of s from one order to the next.
        smallest: pixels of the smallest connected surface.
    """

    def __init__(
        self, shape: tuple[int, int], right: tuple[int, int], projector: tuple[int, int],
        slopes: tuple[float, float], depth: DepthScale, order_step: float, settings: Settings, *, smallest: int,
    ) -> None:  # fmt: skip
        self._right, self._projector, self._settings, self._smallest = right, projector, settings, smallest
        self._slopes = np.float32(slopes[0]), np.float32(slopes[1])
        self._base, self._span, self._step = np.float32(depth.base), np.float32(depth.span), order_step
        self._known, self._link = np.empty(shape, np.uint8), np.empty(shape, np.uint8)
        self._label = np.empty(shape, np.int32)
        self._surfaces = Surfaces(shape)
        self._unique = Uniqueness(shape, (right, projector))

    def certain(self, located: Located, phase: Any, order: Any, modulation: Any) -> NDArray[np.uint8]:
        """1 where a point is certain, else 0, (H, W); valid until the next call.

        Args:
            located: of the left picture; phase: (H, W) float32, wrapped; order: (H, W) int16.
            modulation: (H, W) uint8, counts.
        """
        s, known, label, surfaces = self._settings, self._known, self._label, self._surfaces
        local_outliers(
            located.known, located.residual_eq, located.residual, np.float32(s.max_residual),
            np.float32(s.max_phase_error), known,
        )  # fmt: skip
        components.links(phase, order, located.match_u, located.match_v, *self._slopes, self._link)
        surfaces.find(known, self._link, self._smallest)
        surfaces.paint(label)
        drop_mixed_edges(label, modulation, np.float32(s.edge_modulation), known)
        self._drop_doubtful(located)

        def absolute(entries: Any, pixel: Any, _: Any, out: Any) -> None:
            rivals.absolute_phases(entries, pixel, phase.reshape(-1), order.reshape(-1), out)

        def parameter(entries: Any, _: Any, depth: Any, out: Any) -> None:
            rivals.parameters(entries, depth, self._base, self._span, out)

        for u, v, device, value_of, tolerance in (
            (located.match_u, located.match_v, self._right, absolute, 1.5),
            (located.source_u, located.source_v, self._projector, parameter, self._step / 4),
        ):
            self._unique.apply(
                known, label, surfaces.sizes, u, v, located.depth_mm, device, value_of, tolerance, 4 * self._smallest
            )
        surfaces.find(known, self._link, self._smallest)
        self._drop_doubtful(located)
        return known

    def _drop_doubtful(self, located: Located) -> None:
        f = self._surfaces
        drop_doubtful(
            self._known, located.residual_eq, located.residual, f.start, f.stop, f.count, f.first, f.surface, f.sizes,
            20 * self._smallest, np.float32(self._settings.max_surface_error),
        )  # fmt: skip
