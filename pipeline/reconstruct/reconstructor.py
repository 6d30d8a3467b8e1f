"""The single-shot reconstruction: precomputed tables, then the stages in order for every pair of images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pipeline.attributes.normals import normals_of
from pipeline.common.errors import CalibrationError
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.decode.decoder import Decoder, PhaseMap
from pipeline.decode.kernels.window_fit import weights_of
from pipeline.decode.raw_image import checked, mosaic_of
from pipeline.filter.kernel_warmup import warm_up_conflicts
from pipeline.filter.point_filter import phase_weight
from pipeline.fringe_order.left_right_check import cross_check
from pipeline.fringe_order.order_margins import Limits
from pipeline.fringe_order.order_propagation import propagate
from pipeline.fringe_order.order_search import OrderSearch
from pipeline.geometry.ray_tables import DepthScale
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import MatchResult
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct import camera_response, column_correction
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.column_correction import CorrectionState
from pipeline.reconstruct.consistency import ColumnScan
from pipeline.reconstruct.orders_to_cloud import CloudStage, baselines
from pipeline.reconstruct.search_views import search_views, volume_of_right
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_LEAST_MARGIN = 0.3
"""Share of ``uniqueness_ratio`` that is asked of layouts where every surface's orders have small margins."""
_RESPONSE_ROUNDS, _LEAST_POINTS = 3, 1000
_DISTINCT = 0.5
"""Weight of the projector's phase from which a surface with many ambiguous parts is rejected entirely: in such layouts
only wrong orders have them."""


class Reconstructor:
    """Built once for a calibration, a pattern and a volume; then :meth:`reconstruct` for every pair.

    The result of a pair does not depend on earlier pairs but for the column correction and the cameras' response, which
    the first pair with points sets (see :mod:`.column_correction`, :mod:`.camera_response`), and for the orders that a
    pair with ``use_prior`` expects; nor on the number of threads. Not for use from two threads at once.

    Args:
        calibration: of the rig; pattern: what the projector shows; volume: where surfaces may be.
        encoding: of the raw images, ``rgb8`` or ``bayer_....8``.
        settings: see :class:`pipeline.common.settings.Settings`.
        clock: returns nanoseconds; only used to fill ``Cloud.ms``.
        threads: 0 = all of numba's.

    Raises:
        CalibrationError: when pattern, projector and volume do not fit together.
    """

    mode = "single"

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
        self.correction = column_correction.NO_CORRECTION.copy()
        self.response = camera_response.EQUAL.copy()
        self.calibrated = not self.settings.self_calibrate
        self.other_shifts = np.empty(0)  # of the correction, which explain its pair about as well
        self.scan: ColumnScan | None = None
        self._clock, self._threads = clock, threads
        mosaic = mosaic_of(encoding)
        self.left, self.right = search_views(calibration, pattern, volume, self.settings)
        self._make_decoder = partial(Decoder.of_left, pattern=pattern, mosaic=mosaic, settings=self.settings)
        middle, self._right_middle = (
            DepthScale.of(each).depth(0.5) for each in (volume, volume_of_right(calibration, volume))
        )
        left_decoder = self._make_decoder(calibration, slopes=self.left.slopes, depth_mm=middle)
        self.decoders = [left_decoder, self._right_decoder()]
        weights = weights_of(*self.settings.window(mosaic=mosaic is not None))
        self._correlation = float((weights[:, 1:] * weights[:, :-1]).sum() / (weights**2).sum())
        self.searches = OrderSearch(self.left), OrderSearch(self.right)
        self._distinct = phase_weight(baselines(calibration), linear=self.left.linear)
        self._least_margin = self.settings.uniqueness_ratio / 100 * max(_LEAST_MARGIN, self._distinct)
        self._kept = np.empty(self.left.table.shape, np.int16)
        self._order = np.empty(calibration.left.size[::-1], np.int16)
        self._stages: dict[int, CloudStage] = {}

    def _right_decoder(self) -> Decoder:
        """The right camera's decoder, for its measured response."""
        color = camera_response.with_gains(self.calibration.right_color, self.response[:3])
        rig = replace(self.calibration, right_color=color).swapped()
        return self._make_decoder(rig, slopes=self.right.slopes, depth_mm=self._right_middle)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the first pair showed of the cameras that a user should correct, a sentence each."""
        return camera_response.warnings_of(self.response)

    def state(self) -> CorrectionState:
        """What the first pair sets: column correction and response, 7 numbers, and whether they were measured."""
        return np.concatenate([self.correction, self.response]), self.calibrated

    def restore(self, kept: CorrectionState) -> None:
        """Return to a state that :meth:`state` returned, without a prior."""
        values, self.calibrated = kept
        self.correction = values[:3].copy()
        self._set_response(values[3:].copy())
        self.clear_prior()

    def _set_response(self, response: NDArray[np.float64]) -> None:
        changed = not np.array_equal(response[:3], self.response[:3])
        self.response = response
        if changed:
            self.decoders[1] = self._right_decoder()
        for stage in self._stages.values():
            stage.contrast = float(response[3])

    def warm_up(self, *, strides: tuple[int, ...] = (1,), use_prior: bool = False) -> None:
        """Compile (or load) every kernel by runs on empty images; leaves no trace in the results.

        Args:
            strides: spacings that will be requested; use_prior: whether pairs will follow each other.
        """
        width, height = self.calibration.left.size
        right_width, right_height = self.calibration.right.size
        deep = (3,) if self.encoding == "rgb8" else ()
        kept, other_shifts = self.state(), self.other_shifts
        rng = np.random.default_rng(0)
        left = rng.integers(40, 200, (height, width, *deep), dtype=np.uint8)
        right = rng.integers(40, 200, (right_height, right_width, *deep), dtype=np.uint8)
        self.calibrated = True  # one search loads the kernels of the column correction's hundred
        for stride in strides:
            cloud = self.reconstruct(left, right, stride=stride, use_prior=use_prior)
        self.searches[0].least_costs(*self._maps, self.correction, stride=8)
        warm_up_conflicts()
        self.color(left)
        normals_of(cloud.xyz, cloud.sigma_mm)
        self.restore(kept)
        self.other_shifts = other_shifts

    def reconstruct(
        self, left: NDArray[Any], right: NDArray[Any], *, stride: int = 1, use_prior: bool = False
    ) -> Cloud:
        """Reconstruct the cloud of a pair of raw images.

        Args:
            left, right: uint8, (H, W, 3) for rgb8, (H, W) for a mosaic, of the calibrated sizes.
            stride: points only on every n-th pixel of every n-th row; the others are invalid.
            use_prior: expect the orders of the pair before, if that was reconstructed with ``use_prior`` too, and
                search only where this pair contradicts them.

        Raises:
            ImageError: an image of another size or type.
        """
        if self._threads:
            numba.set_num_threads(min(self._threads, numba.config.NUMBA_NUM_THREADS))
        watch = Stopwatch(self._clock)
        left_map, right_map, order = self.orders(left, right, watch, use_prior=use_prior)
        blind = self._distinct < _DISTINCT
        limits = Limits(self._least_margin, self.other_shifts, not blind or len(self.other_shifts) > 0)
        by_orders = partial(self.searches[0].reject_ambiguous, left_map, right_map, self.correction, limits)
        return self.stage(stride).cloud(left_map, right_map, order, self.correction, watch, reject_ambiguous=by_orders)

    def color(self, left: NDArray[Any]) -> NDArray[np.uint8]:
        """The fringe-free colour of a left raw image, (H, W, 3); see :meth:`pipeline.decode.decoder.Decoder.color`."""
        return self.decoders[0].color(checked(left, "left", self.encoding, self.calibration.left.size))

    def orders(
        self, left: NDArray[Any], right: NDArray[Any], watch: Stopwatch, *, use_prior: bool = False
    ) -> tuple[PhaseMap, PhaseMap, NDArray[np.int16]]:
        """Phases of a pair and the fringe order of every left pixel, valid until the next call; arguments as above."""
        left = checked(left, "left", self.encoding, self.calibration.left.size)
        right = checked(right, "right", self.encoding, self.calibration.right.size)
        if not use_prior:
            self.clear_prior()
        maps = self.decoders[0].decode(left), self.decoders[1].decode(right)
        self._maps = maps
        watch.lap("decode")
        if not self.calibrated and self._has_points(*maps):
            maps = self._calibrate(left, right, maps)
            watch.lap("self_calibration")
        return *maps, self._orders(*maps, watch, use_prior=use_prior)

    def clear_prior(self) -> None:
        """Search the next pair in full."""
        for side in self.searches:
            side.clear_prior()

    def calibrate_columns(self, left: PhaseMap, right: PhaseMap) -> MatchResult:
        """Find the projector's column correction from a pair and keep it; returns the match, valid until the next."""
        self.scan = self.scan_columns(left, right)
        inside = View.of(self.calibration, self.pattern, self.volume, self.settings)
        offsets = column_correction.offsets_to_try(self.settings.self_calibration_range)

        def mean_cost(search: OrderSearch, correction: column_correction.Correction) -> float:
            costs = search.least_costs(left, right, correction, stride=8)
            return float(costs.mean(dtype=np.float64)) if len(costs) else 0.0

        with_margin, within = (
            np.array([mean_cost(search, np.array([offset, 0.0, 0.0])) for offset in offsets])
            for search in (self.searches[0], OrderSearch(inside))
        )
        self.correction = np.array([column_correction.best_offset(offsets, with_margin, within), 0.0, 0.0])
        self.calibrated = True
        self.clear_prior()
        orders = self._orders(left, right, Stopwatch(None), use_prior=False)
        match = self.stage(1).match(left, right, orders, self.correction)
        difference, along, across = column_correction.column_differences(self.left, match, self.correction)
        if len(difference) >= _LEAST_POINTS:
            limit = self.settings.self_calibration_range + 1.0
            self.correction = column_correction.affine_fit(along, across, difference, limit=limit)
        middle = (float(np.median(along)), float(np.median(across))) if len(along) else (0.0, 0.0)
        cost = mean_cost(self.searches[0], self.correction)
        self.clear_prior()
        self.other_shifts = column_correction.other_shifts(offsets, with_margin, self.correction, cost, middle)
        return match

    def _has_points(self, left: PhaseMap, right: PhaseMap) -> bool:
        """Whether a pair has points enough to calibrate with: an empty scene would give any offset."""
        match = self.stage(1).match(
            left, right, self._orders(left, right, Stopwatch(None), use_prior=False), self.correction
        )
        return len(column_correction.column_differences(self.left, match, self.correction)[0]) >= _LEAST_POINTS

    def _calibrate(
        self, left: NDArray[Any], right: NDArray[Any], maps: tuple[PhaseMap, PhaseMap]
    ) -> tuple[PhaseMap, PhaseMap]:
        """Measure column correction and response from a pair of raw images; returns its phases after that."""
        match = self.calibrate_columns(*maps)
        color, other = self.decoders[0].color(left), self.decoders[1].color(right)
        gains = camera_response.gains_of_images(color, other, maps[0].valid, maps[1].valid)
        if (gains != 1).any():
            maps = self._with_gains(gains, right, maps[0])
            match = self.calibrate_columns(*maps)
        for _ in range(_RESPONSE_ROUNDS):
            equal = (self.response == 1).all()
            least = camera_response.UNEQUAL if equal else camera_response.CORRECTED
            gains = camera_response.gains_of_points(color, self.decoders[1].color(right), match, least)
            if (gains == 1).all():
                break
            maps = self._with_gains(gains, right, maps[0])
            orders = self._orders(*maps, Stopwatch(None), use_prior=False)
            match = self.stage(1).match(*maps, orders, self.correction)
        contrast = camera_response.contrast_of_points(*maps, match, self.left.first_axis)
        self._set_response(np.append(self.response[:3], contrast))
        self.clear_prior()
        self._maps = maps
        return maps

    def _with_gains(
        self, gains: NDArray[np.float64], right: NDArray[Any], left_map: PhaseMap
    ) -> tuple[PhaseMap, PhaseMap]:
        """Phases of a pair after the right camera's gains were multiplied."""
        self._set_response(np.append(self.response[:3] * gains, self.response[3]))
        return left_map, self.decoders[1].decode(right)

    def scan_columns(self, left: PhaseMap | None = None, right: PhaseMap | None = None) -> ColumnScan | None:
        """Cost of the order search over column offsets of half a period to both sides; None without fringes.

        Args:
            left, right: phases of a pair; those of the last pair if they are not given.
        """
        left, right = left or self._maps[0], right or self._maps[1]
        period = self.pattern.length / self.pattern.periods
        offsets = column_correction.offsets_to_try(period / 2)
        costs = [
            self.searches[0].least_costs(left, right, np.array([offset, 0.0, 0.0]), stride=16) for offset in offsets
        ]
        self.clear_prior()
        return ColumnScan.of(offsets, costs, self.settings.self_calibration_range)

    def _orders(self, left: PhaseMap, right: PhaseMap, watch: Stopwatch, *, use_prior: bool) -> NDArray[np.int16]:
        """Fringe order of every left pixel, (H, W), valid until the next call."""
        left_search, right_search = self.searches
        left_orders = left_search.search(left, right, self.correction, use_prior=use_prior)
        right_orders = right_search.search(right, left, self.correction, use_prior=use_prior)
        watch.lap("orders")
        cross_check(self.left, left, left_orders, self.right, right, right_orders, self.correction, self._kept)
        propagate(self.left, left, self._kept, self._order)
        if use_prior:
            left_search.set_prior(left, self._kept)
            right_search.set_prior(right, right_orders)
        watch.lap("propagation")
        return self._order

    def stage(self, stride: int) -> CloudStage:
        """The stage that makes clouds of orders, for points on every n-th pixel."""
        if stride not in self._stages:
            self._stages[stride] = CloudStage(
                self.calibration,
                self.volume,
                self.left,
                self.settings,
                self._correlation,
                stride=stride,
                mosaic=self.encoding.startswith("bayer"),
            )
            self._stages[stride].contrast = float(self.response[3])
        return self._stages[stride]
