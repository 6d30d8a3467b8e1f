"""Sets of grey images to clouds: shifted fringes of several frequencies, or of one and a Gray code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import TURN_STEPS, MatchResult
from pipeline.multi_frame import temporal_unwrapping
from pipeline.multi_frame.image_roles import Plan
from pipeline.multi_frame.phase_limits import PhaseLimits
from pipeline.multi_frame.phase_smoothing import CORRELATION
from pipeline.multi_frame.set_color import set_color
from pipeline.multi_frame.set_decoder import SetDecoder, SetPhase, windowed
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct import column_correction
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.column_correction import CorrectionState
from pipeline.reconstruct.orders_to_cloud import CloudStage
from pipeline.reconstruct.search_views import volume_of_right
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_TURN = 2 * np.pi
_COARSE = 4
_FEWEST = 1000
WORST_DEVIATION = 0.6
"""Largest mean deviation of the fringes of a set from each other with which an order is taken, radians."""
WORST_MISFIT = 0.05
"""Contradiction of a set's images that is taken as motion, radians of the finest fringe."""


class GraySets:
    """For one calibration, plan and volume; arguments as of ``SetReconstructor``."""

    def __init__(
        self, calibration: Calibration, plan: Plan, volume: Volume, *, encoding: str, settings: Settings
    ) -> None:
        self.correction = column_correction.NO_CORRECTION.copy()
        self.calibrated = not settings.self_calibrate
        self._calibration, self._volume, self._settings = calibration, volume, settings
        self._encoding, self._steps = encoding, plan.fringes[0].frames
        finest = ColorFringe(plan.size, plan.periods, plan.axis)
        self._left = View.of(calibration, finest, volume, settings)
        swapped, rights = calibration.swapped(), volume_of_right(calibration, volume)
        options: dict[str, Any] = {
            "axis": plan.axis, "per_px": _TURN * plan.periods / plan.length,
            "margin_px": settings.self_calibration_range if settings.self_calibrate else 0.5,
        }  # fmt: skip
        tables = (
            PhaseLimits.of(calibration, volume, **options),
            PhaseLimits.of(swapped, rights, **options, inside=(swapped.right, volume)),
        )
        colors = calibration.left_color, calibration.right_color
        self._decoders = [
            SetDecoder(plan, color, table, encoding=encoding, settings=settings, limits=(WORST_DEVIATION, WORST_MISFIT))
            for color, table in zip(colors, tables, strict=True)
        ]
        self._correlation = CORRELATION if windowed(settings, encoding) else 0.0
        self._stages: dict[int, CloudStage] = {}

    @property
    def warnings(self) -> tuple[str, ...]:
        """Nothing: several images of one channel each do not depend on white balance."""
        return ()

    def state(self) -> list[CorrectionState]:
        """Column correction and whether it was measured, for :meth:`restore`."""
        return [(self.correction, self.calibrated)]

    def restore(self, kept: list[CorrectionState]) -> None:
        """Restore the state."""
        [(self.correction, self.calibrated)] = kept

    def color(self, lefts: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
        """The fringe-free colour, (H, W, 3): the mean over the steps of the finest fringe."""
        return set_color([lefts[n] for n in self._steps], self._calibration.left_color, self._encoding)

    def cloud(
        self, lefts: Sequence[NDArray[Any]], rights: Sequence[NDArray[Any]], stride: int, watch: Stopwatch
    ) -> Cloud:
        """The cloud of a set."""
        left = self._decoders[0].decode(lefts, "left")
        right = self._decoders[1].decode(rights, "right")
        watch.lap("decode")
        if not self.calibrated:
            self._calibrate_columns(left, right)
            watch.lap("self_calibration")
        cloud = self._stage(stride).cloud(
            left.map, right.map, left.order, self.correction, watch, confirm=lambda found: self._confirm(found, right)
        )
        return replace(cloud, moved=max(left.moved, right.moved))

    def _confirm(self, match: MatchResult, right: SetPhase) -> None:
        temporal_unwrapping.confirm(
            len(match.valid), match.valid, match.absolute_phase, match.right_u, match.right_v, right.absolute_phase,
            np.float32(TURN_STEPS / _TURN), np.float32(self._settings.consistency_threshold),
        )  # fmt: skip

    def _calibrate_columns(self, left: SetPhase, right: SetPhase) -> None:
        """Find the projector's column correction from a set and keep it, if the set has enough points.

        Among some offsets of the projector the one with the most matches that both cameras confirm is chosen, then an
        affine fit.
        """
        best, most = 0.0, -1
        for offset in column_correction.offsets_to_try(self._settings.self_calibration_range, step=1.0):
            agreed_orders = int(np.count_nonzero(self._match(left, right, np.array([offset, 0.0, 0.0])).valid))
            if agreed_orders > 1.02 * most:
                best, most = float(offset), agreed_orders
        correction = np.array([best, 0.0, 0.0])
        match = self._match(left, right, correction)
        difference, along, across = column_correction.column_differences(self._left, match, correction)
        if len(difference) >= _FEWEST // _COARSE:
            limit = self._settings.self_calibration_range + 1.0
            self.correction = column_correction.affine_fit(along, across, difference, limit=limit)
            self.calibrated = True

    def _match(self, left: SetPhase, right: SetPhase, correction: NDArray[np.float64]) -> MatchResult:
        """Points of a coarse lattice, confirmed by the right image."""
        order = np.ascontiguousarray(left.order[::_COARSE, ::_COARSE])
        match = self._stage(_COARSE).match(left.map.subsampled(_COARSE), right.map, order, correction)
        self._confirm(match, right)
        return match

    def _stage(self, stride: int) -> CloudStage:
        if stride not in self._stages:
            self._stages[stride] = CloudStage(
                self._calibration, self._volume, self._left, self._settings, self._correlation, stride=stride
            )
        return self._stages[stride]
