"""A set of pairs of pictures to one cloud."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Items
from dataclasses import replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pipeline import self_calibration
from pipeline.calibration import Calibration
from pipeline.cloud import Cloud, Volume
from pipeline.errors import CalibrationError, PatternError, PictureError
from pipeline.located import TURN_STEPS, Located
from pipeline.modes import orders
from pipeline.modes.decoder import ENCODINGS, SetDecoder, SetPhase
from pipeline.modes.plan import plan_of
from pipeline.modes.tables import SetTables
from pipeline.pattern import ColorFringe
from pipeline.reconstruct import volume_of_right
from pipeline.rehearsal import rehearse_contest
from pipeline.sequence import Sequence
from pipeline.settings import Settings
from pipeline.stopwatch import Stopwatch
from pipeline.surface import SurfaceStage
from pipeline.view import View

_TURN = 2 * np.pi
_COARSE = 4
_FEWEST = 1000
WORST_DEVIATION = 0.6
"""Largest mean deviation of the fringes of a set from each other with which an order is taken, radians."""
WORST_MISFIT = 0.08
"""Contradiction of a set's pictures from which a pixel has moved, radians of the finest fringe."""


class SetReconstructor:
    """Built once for a calibration, a sequence and a volume; then :meth:`reconstruct` for every set.

    Everything that holds for :class:`pipeline.reconstruct.Reconstructor` holds here: sets do not depend on each other
    but for the projector's column correction, which the first set gives, nor on the number of threads.

    Args:
        calibration: of the rig; sequence: what the projector shows, such as
            :func:`pipeline.modes.sequences.mode_sequence` makes; volume: where surfaces may be.
        encoding: of the raw pictures, ``rgb8``, ``bayer_....8``, ``mono8`` or ``mono16``.
        settings, clock, threads: as there.

    Raises:
        CalibrationError: when sequence, projector and volume do not fit together.
        PatternError: the sequence cannot be measured with; PictureError: the encoding is not known.
    """

    def __init__(
        self,
        calibration: Calibration,
        sequence: Sequence,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        clock: Callable[[], int] | None = None,
        threads: int = 0,
    ) -> None:
        if sequence.size != calibration.projector.size:
            raise CalibrationError(
                f"pattern.size {list(sequence.size)} is not the size of the calibrated projector, "
                f"{list(calibration.projector.size)}"
            )
        if encoding not in ENCODINGS:
            raise PictureError(f"encoding {encoding!r:.80} is not known; expected one of {', '.join(ENCODINGS)}")
        self.calibration, self.sequence, self.volume, self.encoding = calibration, sequence, volume, encoding
        self.settings = s = settings or Settings()
        self.plan = plan = plan_of(sequence)
        if plan.kind != "heterodyne":
            raise PatternError(f"sequence {sequence.name!r}: a set of kind {plan.kind} is not measured yet")
        self.correction = self_calibration.NO_CORRECTION.copy()
        self._calibrated = not s.self_calibrate
        self._clock, self._threads = clock, threads
        finest = ColorFringe(plan.size, plan.periods, plan.axis)
        self._left = View.of(calibration, finest, volume, s, calibration.left_color, None)
        swapped, rights = calibration.swapped(), volume_of_right(calibration, volume)
        options: dict[str, Any] = {
            "axis": plan.axis, "per_px": _TURN * plan.periods / plan.length,
            "margin_px": s.self_calibration_range if s.self_calibrate else 0.5,
        }  # fmt: skip
        tables = (
            SetTables.of(calibration, volume, **options),
            SetTables.of(swapped, rights, **options, inside=(swapped.right, volume)),
        )
        colors = calibration.left_color, calibration.right_color
        self._decoders = [
            SetDecoder(plan, color, table, encoding=encoding, settings=s, limits=(WORST_DEVIATION, WORST_MISFIT))
            for color, table in zip(colors, tables, strict=True)
        ]
        self._stages: dict[int, SurfaceStage] = {}

    def warm_up(self, *, every: tuple[int, ...] = (1,)) -> None:
        """Compile (or load) every kernel by runs on empty pictures; leaves no trace in the results.

        Args:
            every: spacings that will be asked for.
        """
        kept = self.correction, self._calibrated
        rng = np.random.default_rng(0)
        kind = np.uint16 if self.encoding == "mono16" else np.uint8
        deep = (3,) if self.encoding == "rgb8" else ()
        sides = [
            [rng.integers(40, 200, (*camera.size[::-1], *deep), dtype=kind)] * len(self.sequence)
            for camera in (self.calibration.left, self.calibration.right)
        ]
        for step in every:
            self.reconstruct(*sides, every=step)
        rehearse_contest()
        self.correction, self._calibrated = kept

    def reconstruct(self, lefts: Items[NDArray[Any]], rights: Items[NDArray[Any]], *, every: int = 1) -> Cloud:
        """The cloud of a set of raw pictures, one of each camera for each frame of the sequence, in its order.

        Args:
            lefts, rights: (H, W, 3) for rgb8, else (H, W), of the calibrated sizes; uint16 for mono16, else uint8.
            every: points only on every n-th pixel of every n-th row; the others are unknown.

        Raises:
            PictureError: another number of pictures, or a picture of another size or type.
        """
        if self._threads:
            numba.set_num_threads(min(self._threads, numba.config.NUMBA_NUM_THREADS))
        watch = Stopwatch(self._clock)
        left = self._decoders[0].decode(lefts, "left")
        right = self._decoders[1].decode(rights, "right")
        watch.lap("decode")
        if not self._calibrated:
            self._calibrate_columns(left, right)
            watch.lap("self_calibration")
        cloud = self._stage(every).cloud(
            left.map, right.map, left.order, self.correction, watch, confirm=lambda found: self._confirm(found, right)
        )
        return replace(cloud, moved=left.moved)

    def _confirm(self, located: Located, right: SetPhase) -> None:
        orders.confirm(
            located.known, located.absolute, located.match_u, located.match_v, right.absolute,
            np.float32(TURN_STEPS / _TURN), np.float32(self.settings.max_check),
        )  # fmt: skip

    def _calibrate_columns(self, left: SetPhase, right: SetPhase) -> None:
        """Find the projector's column correction from a set and keep it.

        The pixels that both cameras agree about tell how far off the projector is: among some offsets the one with
        the most of them, then an affine fit.
        """
        best, most = 0.0, -1
        for offset in self_calibration.offsets_to_try(self.settings.self_calibration_range, step=1.0):
            agreed = int(np.count_nonzero(self._located(left, right, np.array([offset, 0.0, 0.0])).known))
            if agreed > 1.02 * most:
                best, most = float(offset), agreed
        self._calibrated = True
        correction = np.array([best, 0.0, 0.0])
        located = self._located(left, right, correction)
        difference, along, across = self._left.column_differences(located, correction)
        if len(difference) >= _FEWEST // _COARSE:
            limit = self.settings.self_calibration_range + 1.0
            correction = self_calibration.affine_fit(along, across, difference, limit=limit)
        self.correction = correction

    def _located(self, left: SetPhase, right: SetPhase, correction: NDArray[np.float64]) -> Located:
        """Points of a coarse lattice, confirmed by the right picture."""
        order = np.ascontiguousarray(left.order[::_COARSE, ::_COARSE])
        located = self._stage(_COARSE).locate(left.map.every(_COARSE), right.map, order, correction)
        self._confirm(located, right)
        return located

    def _stage(self, every: int) -> SurfaceStage:
        if every not in self._stages:
            self._stages[every] = SurfaceStage(self.calibration, self._left, self.settings, 0.0, every=every)
        return self._stages[every]
