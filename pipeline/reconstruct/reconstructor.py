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
from pipeline.filter.occlusion.kernel_warmup import warm_up_conflicts
from pipeline.filter.point_filter import phase_weight
from pipeline.filter.surfaces.surface_evidence import DISTINCT
from pipeline.fringe_order.left_right_check import cross_check
from pipeline.fringe_order.margins.order_margins import EVEN, Limits
from pipeline.fringe_order.order_propagation import propagate
from pipeline.fringe_order.order_search import UNCALIBRATED, OrderSearch
from pipeline.geometry.ray_tables import DepthScale
from pipeline.match.match_result import MatchResult
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.fringe_width import width_warnings
from pipeline.reconstruct import camera_response, column_correction, first_pair
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.column_correction import CorrectionState
from pipeline.reconstruct.consistency import ColumnScan
from pipeline.reconstruct.orders_to_cloud import CloudStage, baselines
from pipeline.reconstruct.search_views import search_views, volume_of_right
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_LEAST_MARGIN = 0.3
"""Share of ``uniqueness_ratio`` that is asked of layouts where every surface's orders have small margins."""


class Reconstructor:
    """Built once for a calibration, a pattern and a volume; then :meth:`reconstruct` for every pair.

    The result of a pair does not depend on earlier pairs but for the column correction and the cameras' response, which
    the first pair with points sets (see :mod:`.first_pair`), and for the orders that a
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
        self.gain = 0.0  # of the correction, in log likelihood per pixel of its pair
        self.scan: ColumnScan | None = None
        self._clock, self._threads = clock, threads
        mosaic = mosaic_of(encoding)
        self._mosaic = mosaic is not None
        self.left, self.right = search_views(calibration, pattern, volume, self.settings)
        self._make_decoder = partial(Decoder.of_left, pattern=pattern, mosaic=mosaic, settings=self.settings)
        middle, self._right_middle = (
            DepthScale.of(each).depth(0.5) for each in (volume, volume_of_right(calibration, volume))
        )
        left_decoder = self._make_decoder(calibration, slopes=self.left.slopes, depth_mm=middle)
        self.decoders = [left_decoder, self._right_decoder()]
        weights = weights_of(*self.settings.window(mosaic=self._mosaic))
        self._correlation = float((weights[:, 1:] * weights[:, :-1]).sum() / (weights**2).sum())
        distinct = phase_weight(baselines(calibration), self.left.column_to_phase, linear=self.left.linear)
        #: Fringes that repeat, or nearly so: orders must be unique in the right image.
        self.repeats = distinct < DISTINCT
        # Where they do, wrong orders may cost as little as right ones, and only the links decide.
        search = partial(OrderSearch, by_brightness=not self.repeats)
        self.searches = search(self.left), search(self.right)
        self._least_margin = self.settings.uniqueness_ratio / 100 * max(_LEAST_MARGIN, distinct)
        self._kept, self._place = (np.empty(self.left.table.shape, kind) for kind in (np.int16, np.int32))
        self._order = np.empty(calibration.left.size[::-1], np.int16)
        self._stages: dict[int, CloudStage] = {}

    def _right_decoder(self) -> Decoder:
        """The right camera's decoder, for its measured response."""
        color = camera_response.with_gains(self.calibration.right_color, self.response[:3])
        rig = replace(self.calibration, right_color=color).swapped()
        made = self._make_decoder(rig, slopes=self.right.slopes, depth_mm=self._right_middle)
        factor = self.response[camera_response.VIGNETTING] / self.response[camera_response.BRIGHTNESS]
        made.correct(self.response[camera_response.ERROR], factor)
        return made

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at cameras and pattern, and why surfaces get no points, a sentence each."""
        first = camera_response.warnings_of(self.response) + column_correction.warnings_of(self.other_shifts)
        return first + width_warnings(self.calibration, self.pattern, mosaic=self._mosaic)

    def state(self) -> CorrectionState:
        """What the first pair sets: column correction and response, 22 numbers, and whether they were measured."""
        return np.concatenate([self.correction, self.response]), self.calibrated

    def restore(self, kept: CorrectionState) -> None:
        """Return to a state that :meth:`state` returned, without a prior."""
        values, self.calibrated = kept
        self.correction = values[:3].copy()
        self.set_response(values[3:].copy())
        self.clear_prior()

    def set_response(self, response: NDArray[np.float64]) -> None:
        """Set the response (19,), see :mod:`.camera_response`."""
        later = [camera_response.CONTRAST, camera_response.TEXTURE]  # used after decoding
        changed = not np.array_equal(np.delete(response, later), np.delete(self.response, later))
        self.response = response
        if changed:
            self.decoders[0].correct(response[camera_response.ERROR])
            self.decoders[1] = self._right_decoder()
        for search in self.searches:
            search.weight_texture(float(response[camera_response.TEXTURE]))
        for stage in self._stages.values():
            self._set_response_of(stage)

    def _set_response_of(self, stage: CloudStage) -> None:
        stage.contrast = float(self.response[camera_response.CONTRAST])
        even = camera_response.EQUAL[camera_response.VIGNETTING]
        stage.uneven = not np.array_equal(self.response[camera_response.VIGNETTING], even)
        stage.corrected_scatter = camera_response.scatter_of(self.response[camera_response.ERROR])

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
        faulty = camera_response.EQUAL.copy()
        faulty[camera_response.ERROR] = 1e-3
        self.set_response(faulty)
        for stride in strides:
            cloud = self.reconstruct(left, right, stride=stride, use_prior=use_prior)
        self.searches[0].least_costs(*self._maps, self.correction, stride=8)
        self.searches[0].reject_contradicted(*self._maps, self.correction, self.right, self._kept)
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
            stride: points only on every n-th pixel of every n-th row, 1 or 2; the others are invalid.
            use_prior: expect the orders of the pair before, if that was reconstructed with ``use_prior`` too, and
                search only where this pair contradicts them.

        Raises:
            ImageError: an image of another size or type. ValueError: another stride.
        """
        if stride not in (1, 2):
            raise ValueError(f"stride is {stride}, expected 1 or 2")
        if self._threads:
            numba.set_num_threads(min(self._threads, numba.config.NUMBA_NUM_THREADS))
        watch = Stopwatch(self._clock)
        left_map, right_map, order = self.orders(left, right, watch, use_prior=use_prior)
        limits = Limits(self._least_margin, self.other_shifts, EVEN if self.repeats else -1.0, self.gain)
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
        maps = self.decode(left, right)
        watch.lap("decode")
        if not self.calibrated and first_pair.has_points(self, *maps):
            maps = first_pair.calibrate(self, left, right, maps)
            watch.lap("self_calibration")
        self._maps = maps
        return *maps, self._orders(*maps, watch, use_prior=use_prior)

    def decode(self, left: NDArray[Any], right: NDArray[Any]) -> tuple[PhaseMap, PhaseMap]:
        """Phases of a pair of raw images, valid until the next call, without the left image's colour cast."""
        cast = self.decoders[0].cast(left)
        return self.decoders[0].decode(left, cast), self.decoders[1].decode(right, cast)

    def clear_prior(self) -> None:
        """Search the next pair in full."""
        for side in self.searches:
            side.clear_prior()

    def scan_columns(self) -> ColumnScan | None:
        """Cost of the order search over column offsets of half a period to both sides, of the last pair's phases."""
        return first_pair.scan_columns(self, *self._maps)

    def current_cost(self) -> float | None:
        """Cost of the last pair's orders, see :func:`.consistency.relative_cost`; None without a scan or fringes."""
        return None if self.scan is None else first_pair.current_cost(self, *self._maps, self.scan)

    def brightness_has_changed(self) -> bool:
        """Whether the right camera's brightness, relative to the left one's, is not that of the first pair any more."""
        now = camera_response.brightness_of_points(*self._maps, self.match(*self._maps))
        self.clear_prior()
        return abs(now / float(self.response[camera_response.BRIGHTNESS]) - 1) > camera_response.BRIGHTER

    def match(self, left: PhaseMap, right: PhaseMap) -> MatchResult:
        """The match of every left pixel by the search of an uncalibrated pair; valid until the next call."""
        orders = self._orders(left, right, Stopwatch(None), use_prior=False, texture=UNCALIBRATED)
        return self.stage(1).match(left, right, orders, self.correction)

    def _orders(
        self, left: PhaseMap, right: PhaseMap, watch: Stopwatch, *, use_prior: bool, texture: float = 1.0
    ) -> NDArray[np.int16]:
        """Fringe order of every left pixel, (H, W), valid until the next call."""
        left_search, right_search = self.searches
        left_orders = left_search.search(left, right, self.correction, use_prior=use_prior, texture=texture)
        right_orders = right_search.search(right, left, self.correction, use_prior=use_prior, texture=texture)
        watch.lap("orders")
        cross_check(
            self.left, left, left_orders, self.right, right, right_orders, self.correction, self._kept, self._place
        )
        left_search.reject_unseen(left, right, self.correction, self.right, self._place, self._kept)
        if self.repeats:
            left_search.reject_contradicted(left, right, self.correction, self.right, self._kept)
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
                mosaic=self._mosaic,
            )
            self._set_response_of(self._stages[stride])
        return self._stages[stride]
