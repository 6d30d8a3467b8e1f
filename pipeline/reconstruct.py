"""One pair of pictures to one cloud: every table that can be precomputed, then the stages in order."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pipeline import gates, self_calibration
from pipeline.calibration import Calibration
from pipeline.cloud import Cloud, Volume
from pipeline.errors import CalibrationError
from pipeline.pattern import ColorFringe
from pipeline.phase import PhaseMap
from pipeline.raw import checked, mosaic_of
from pipeline.refine import refine
from pipeline.settings import Settings
from pipeline.stopwatch import Stopwatch
from pipeline.view import View
from pipeline.window_fit import weights_of

MAX_LABELS = 64


class Reconstructor:
    """Built once for a calibration, a pattern and a volume; then :meth:`reconstruct` for every pair.

    The result of a pair does not depend on earlier pairs but for the projector's column correction, which the first
    pair sets (see :meth:`calibrate_columns`), nor on the number of threads. Not for use from two threads at once.

    Args:
        calibration: of the rig; pattern: what the projector shows; volume: where surfaces may be.
        encoding: of the raw pictures, ``rgb8`` or ``bayer_....8``.
        settings: see :class:`pipeline.settings.Settings`.
        clock: returns nanoseconds; only used to fill ``Cloud.ms``.
        threads: 0 = all that numba knows of.

    Raises:
        CalibrationError: when pattern, projector and volume do not fit together.
    """

    def __init__(
        self,
        calibration: Calibration,
        pattern: ColorFringe,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        clock: Callable[[], int] | None = None,
        threads: int = 0,
    ) -> None:
        if pattern.size != calibration.projector.size:
            raise CalibrationError(
                f"pattern.size {list(pattern.size)} is not the size of the calibrated projector, "
                f"{list(calibration.projector.size)}"
            )
        self.calibration, self.pattern, self.volume, self.encoding = calibration, pattern, volume, encoding
        self.settings = settings or Settings()
        self.correction = self_calibration.NO_CORRECTION.copy()
        self._calibrated = not self.settings.self_calibrate
        self._clock, self._threads = clock, threads
        mosaic = mosaic_of(encoding)
        swapped = calibration.swapped()
        self._left = View.of(calibration, pattern, volume, self.settings, calibration.left_color, mosaic)
        # The right view only confirms the left one: fewer rows serve.
        self._right = View.of(
            swapped, pattern, _volume_of_right(calibration, volume), self.settings, calibration.right_color, mosaic,
            inside=(swapped.right, volume), coarser=2,
        )  # fmt: skip
        self._rays = calibration.left.rays().astype(np.float32)
        weights = weights_of(*self.settings.window(mosaic=mosaic is not None))
        self._correlation = float((weights[:, 1:] * weights[:, :-1]).sum() / (weights**2).sum())
        self._labels = max(self._left.labels, self._right.labels)
        if self._labels > MAX_LABELS:
            raise CalibrationError(
                f"up to {self._labels} fringe orders fit into the volume {volume.near_mm} .. {volume.far_mm} mm, limit "
                f"{MAX_LABELS}; make the volume smaller or use fewer periods"
            )

    def warm_up(self) -> None:
        """Compile (or load) every kernel by one run on empty pictures; leaves no trace in the results."""
        width, height = self.calibration.left.size
        right_width, right_height = self.calibration.right.size
        deep = (3,) if self.encoding == "rgb8" else ()
        kept = self.correction, self._calibrated
        rng = np.random.default_rng(0)
        left = rng.integers(40, 200, (height, width, *deep), dtype=np.uint8)
        right = rng.integers(40, 200, (right_height, right_width, *deep), dtype=np.uint8)
        for every, follow in ((1, False), (1, True), (2, False), (2, True)):
            self.reconstruct(left, right, every=every, follow=follow)
        self.correction, self._calibrated = kept

    def reconstruct(
        self,
        left: NDArray[Any],
        right: NDArray[Any],
        *,
        every: int = 1,  # noqa: ARG002
        follow: bool = False,  # noqa: ARG002
    ) -> Cloud:
        """The cloud of a pair of raw pictures.

        Args:
            left, right: uint8, (H, W, 3) for rgb8, (H, W) for a mosaic, of the calibrated sizes.

        Raises:
            PictureError: a picture of another size or type.
        """
        left = checked(left, "left", self.encoding, self.calibration.left.size)
        right = checked(right, "right", self.encoding, self.calibration.right.size)
        if self._threads:
            numba.set_num_threads(min(self._threads, numba.config.NUMBA_NUM_THREADS))
        watch = Stopwatch(self._clock)
        maps = self._left.decode(left), self._right.decode(right)
        watch.lap("decode")
        if not self._calibrated:
            self.calibrate_columns(*maps)
            watch.lap("self_calibration")
        orders = self._orders(maps[0], maps[1], watch)
        return self._finish(maps[0], maps[1], orders, watch)

    def calibrate_columns(self, left: PhaseMap, right: PhaseMap) -> None:
        """Find the projector's column correction from a pair and keep it."""
        best, least = 0.0, np.inf
        for offset in self_calibration.offsets_to_try(self.settings.self_calibration_range):
            trial = np.array([offset, 0.0, 0.0])
            costs, _, count = self._left.costs(left, right, trial, self._labels, self._right.slopes, every=8)
            cost = self_calibration.mean_best_cost(costs, count)
            if cost < least - 1e-6:
                best, least = float(offset), cost
        self.correction = np.array([best, 0.0, 0.0])
        self._calibrated = True
        quiet = Stopwatch(None)
        orders = self._orders(left, right, quiet)
        located = self._locate(left, right, orders)
        difference, along, across = self._left.column_differences(located, self.correction)
        if len(difference) >= 1000:
            limit = self.settings.self_calibration_range + 1.0
            self.correction = self_calibration.affine_fit(along, across, difference, limit=limit)

    def _orders(self, left: PhaseMap, right: PhaseMap, watch: Stopwatch) -> NDArray[np.int16]:
        """Fringe order of every left pixel, (H, W)."""
        decided = []
        for view, other, here, there in (
            (self._left, self._right, left, right),
            (self._right, self._left, right, left),
        ):
            costs, first, count = view.costs(here, there, self.correction, self._labels, other.slopes)
            watch.lap("candidates")
            decided.append(view.decide(here, costs, first, count))
            watch.lap("aggregation")
        kept = self._left.cross_check(left, decided[0], self._right, right, decided[1], self.correction)
        order = self._left.spread(left, kept)
        watch.lap("propagation")
        return order

    def _locate(self, left: PhaseMap, right: PhaseMap, order: NDArray[np.int16]) -> tuple[Any, ...]:
        view = self._left
        return refine(
            order, view.table.rows, view.table.columns, view.table.along, self._rays, left.phase, left.phase_eq,
            left.phasor, left.variance, right.phasor, right.variance, view.other, view.projector, view.first_axis,
            view.depth.base, view.depth.span, view.columns, view.phases, self.correction,
            self.settings.min_modulation**2, self._correlation,
        )  # fmt: skip

    def _finish(self, left: PhaseMap, right: PhaseMap, order: NDArray[np.int16], watch: Stopwatch) -> Cloud:
        depth, sigma, match, source, residual = self._locate(left, right, order)
        watch.lap("refinement")
        known = self._gate(left, order, depth, match, source, residual)
        watch.lap("gates")
        unknown = ~known
        depth[unknown] = np.nan
        sigma[unknown] = np.nan
        xyz = np.empty((*depth.shape, 3), np.float32)
        np.multiply(self._rays, depth[..., None], out=xyz[..., :2])
        xyz[..., 2] = depth
        cloud = Cloud(
            xyz=xyz,
            sigma_mm=sigma,
            gray=np.clip(np.rint(left.mean), 0, 255).astype(np.uint8),
            modulation=(left.modulation, right.modulation),
            order=np.where(known, order, -1).astype(np.int16),
            saturated=(left.clipped, right.clipped),
            ms=watch.ms,
        )
        watch.lap("output")
        return cloud

    def _gate(
        self, left: PhaseMap, order: Any, depth: Any, match: Any, source: Any, residual: Any
    ) -> NDArray[np.bool_]:
        known = gates.local_outliers(
            residual, np.isfinite(depth), self.settings.max_residual, self.settings.max_phase_error, 3
        )
        smallest = self.settings.min_component
        absolute = left.phase + np.float32(2 * np.pi) * order
        slope_x, slope_y = self._left.slopes
        label, size = gates.components(known, absolute, match, slope_x, slope_y)
        known = gates.drop_mixed_edges(known, label, left.modulation, self.settings.edge_modulation)
        gates.drop_doubtful(known, label, size, residual, smallest, self.settings.max_surface_error)
        s = (1 / depth - self._left.depth.base) / self._left.depth.span
        for place, value, device, tolerance in (
            (match, absolute, self.calibration.right, 1.5),
            (source, s, self.calibration.projector, self._left.order_step / 4),
        ):
            gates.unique(known, place, value, depth, label, size, device.size[::-1], tolerance, 4 * smallest)
        label, size = gates.components(known, absolute, match, slope_x, slope_y)
        gates.drop_doubtful(known, label, size, residual, smallest, self.settings.max_surface_error)
        return known


def _volume_of_right(calibration: Calibration, volume: Volume) -> Volume:
    """Limits along the right camera's z axis that hold the whole measuring volume of the left one."""
    width, height = calibration.left.size
    corners = np.array([[0, 0], [width - 1, 0], [0, height - 1], [width - 1, height - 1]], dtype=np.float64)
    rays = np.concatenate([calibration.left.normalise(corners), np.ones((4, 1))], axis=1)
    points = np.concatenate([rays * volume.near_mm, rays * volume.far_mm])
    z = (points @ calibration.right.rotation.T + calibration.right.translation)[:, 2]
    if z.min() <= 0:
        raise CalibrationError(
            "part of the measuring volume lies behind the right camera; check its pose and the volume"
        )
    return Volume(float(z.min()), float(z.max()))
