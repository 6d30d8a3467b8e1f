"""A set of pairs of images to one cloud."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from pipeline.attributes.normals import normals_of
from pipeline.common.errors import CalibrationError, ImageError
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.filter.occlusion.kernel_warmup import warm_up_conflicts
from pipeline.multi_frame.color_sets import ColorSets
from pipeline.multi_frame.gray_sets import GraySets
from pipeline.multi_frame.image_roles import plan_of
from pipeline.multi_frame.set_decoder import ENCODINGS
from pipeline.pattern.sequence import FrameSequence
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import CloudFilters
from pipeline.reconstruct.column_correction import Correction, CorrectionState
from pipeline.reconstruct.consistency import Consistency
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

Judge = Callable[[Correction, bool], Consistency]
"""Verdict on a column correction and whether it was measured."""


class SetReconstructor:
    """Built once for a calibration, a sequence and a volume; then :meth:`reconstruct` for every set.

    Everything that holds for :class:`pipeline.reconstruct.reconstructor.Reconstructor` holds here: sets do not depend
    on each other but for the projector's column correction, which the first set gives, nor on the number of threads.

    Args:
        calibration: of the rig; sequence: what the projector shows, such as
            :func:`pipeline.pattern.mode_sequences.mode_sequence` makes; volume: where surfaces may be.
        encoding: of the raw images, ``rgb8``, ``bayer_....8``, ``mono8`` or ``mono16``.
        settings, clock, threads: as there; filters: of the clouds, None = none.
        check: makes the judge of the first set's column correction, from calibration, volume and axis (0 = columns);
            None = not judged. withhold: a cloud of an inconsistent correction has no points.

    Raises:
        CalibrationError: when sequence, projector and volume do not fit together.
        PatternError: the sequence cannot be measured with; ImageError: the encoding is not known.
    """

    def __init__(
        self,
        calibration: Calibration,
        sequence: FrameSequence,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        clock: Callable[[], int] | None = None,
        threads: int = 0,
        filters: CloudFilters | None = None,
        check: Callable[[Calibration, Volume, int], Judge] | None = None,
        withhold: bool = True,
    ) -> None:
        if sequence.size != calibration.projector.size:
            raise CalibrationError(
                f"pattern.size {list(sequence.size)} is not the size of the calibrated projector, "
                f"{list(calibration.projector.size)}"
            )
        if encoding not in ENCODINGS:
            raise ImageError(f"encoding {encoding!r:.80} is not known; expected one of {', '.join(ENCODINGS)}")
        self.calibration, self.sequence, self.volume, self.encoding = calibration, sequence, volume, encoding
        self.settings, self.plan = settings or Settings(), plan_of(sequence)
        self.mode = sequence.name
        self._clock, self._threads, self._filters = clock, threads, filters
        make = ColorSets if self.plan.kind == "two_color" else GraySets
        self._sets = make(calibration, self.plan, volume, encoding=encoding, settings=self.settings)
        self._judge = None if check is None else check(calibration, volume, 0 if self.plan.axis == "x" else 1)
        self._withhold = withhold

    @property
    def correction(self) -> NDArray[np.float64]:
        """Of the projector's columns: offset, slope along, slope across; observed minus calibrated coordinate."""
        return self._sets.correction

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras."""
        return self._sets.warnings

    def state(self) -> list[CorrectionState]:
        """What sets change: column corrections and whether they were measured, for :meth:`restore`."""
        return self._sets.state()

    def restore(self, kept: list[CorrectionState]) -> None:
        """Return to the state that :meth:`state` returned."""
        self._sets.restore(kept)

    def warm_up(self, *, strides: tuple[int, ...] = (1,), use_prior: bool = False) -> None:  # noqa: ARG002 - see below
        """Compile (or load) every kernel by runs on empty images; leaves no trace in the results.

        Args:
            strides: spacings that will be requested; use_prior: without effect, sets have no prior.
        """
        kept = self.state()
        rng = np.random.default_rng(0)
        kind = np.uint16 if self.encoding == "mono16" else np.uint8
        deep = (3,) if self.encoding == "rgb8" else ()
        sides = [
            [rng.integers(40, 200, (*camera.size[::-1], *deep), dtype=kind)] * len(self.sequence)
            for camera in (self.calibration.left, self.calibration.right)
        ]
        for stride in strides:
            cloud = self.reconstruct(*sides, stride=stride)
        warm_up_conflicts()
        self.color(sides[0])
        normals_of(cloud.xyz, cloud.sigma_mm)
        if self._filters is not None:
            self._filters.restart()
        self.restore(kept)

    def color(self, lefts: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
        """The fringe-free colour of a set's left raw images, on the clouds' grid; grey with monochrome cameras."""
        color = self._sets.color(lefts)
        return color if self._filters is None else self._filters.texture(color)

    def reconstruct(
        self,
        lefts: Sequence[NDArray[Any]],
        rights: Sequence[NDArray[Any]],
        *,
        stride: int = 1,
        use_prior: bool = False,  # noqa: ARG002 - see below
    ) -> Cloud:
        """The cloud of a set of raw images, one of each camera for each frame of the sequence, in its order.

        Args:
            lefts, rights: (H, W, 3) for rgb8, else (H, W), of the calibrated sizes; uint16 for mono16, else uint8.
            stride: points only on every n-th pixel of every n-th row; the others are unknown.
            use_prior: without effect, sets have no prior.

        Raises:
            ImageError: another number of images, or an image of another size or type.
        """
        if self._threads:
            numba.set_num_threads(min(self._threads, numba.config.NUMBA_NUM_THREADS))
        watch = Stopwatch(self._clock)
        before = self.state()
        cloud = self._sets.cloud(lefts, rights, stride, watch)
        if self._judge is not None:
            found = self._judge(self.correction, self.settings.self_calibrate and self.state()[0][1])
            cloud = replace(cloud, consistency=found)
            if found.verdict == "inconsistent":
                self.restore(before)  # the next set is measured like a first one
                cloud = cloud.withheld() if self._withhold else cloud
        return cloud if self._filters is None else self._filters.apply(cloud, stride=stride)
