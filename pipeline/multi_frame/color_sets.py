"""From sets of two colour fringes to clouds: the single shot of the first, with orders that the second confirms.

Left and right are matched in images of one instant: motion between the two fringes makes orders disagree, which costs
coverage, but does not displace points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import ImageError
from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.multi_frame import temporal_unwrapping
from pipeline.multi_frame.image_roles import Plan
from pipeline.multi_frame.order_agreement import agreed_orders
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.column_correction import CorrectionState
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

WORST_DEVIATION = np.float32(0.6)
"""Largest deviation of the second phase from the one predicted by the first, radians; a wrong period gives 1.26."""


class ColorSets:
    """For one calibration, plan and volume; arguments as of ``SetReconstructor``."""

    def __init__(
        self, calibration: Calibration, plan: Plan, volume: Volume, *, encoding: str, settings: Settings
    ) -> None:
        self._reconstructors = [
            Reconstructor(calibration, fringe, volume, encoding=encoding, settings=settings) for fringe in plan.colors
        ]
        self._ratio = np.float32(plan.colors[1].periods / plan.colors[0].periods)
        shape = calibration.left.size[::-1]
        self._order, self._unused = np.empty(shape, np.int16), np.empty(shape, np.int32)
        self._deviation, self._lit, self._absolute_phase = (np.empty(shape, np.float32) for _ in range(3))

    @property
    def correction(self) -> NDArray[np.float64]:
        """Of the projector's columns."""
        return self._reconstructors[0].correction

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras."""
        return self._reconstructors[0].warnings

    def state(self) -> list[CorrectionState]:
        """Column correction of each reconstructor and whether it was measured, for :meth:`restore`."""
        return [one.state() for one in self._reconstructors]

    def restore(self, kept: list[CorrectionState]) -> None:
        """Restore the state."""
        for one, state in zip(self._reconstructors, kept, strict=True):
            one.restore(state)

    def color(self, lefts: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
        """The fringe-free colour, of the first image."""
        return self._reconstructors[0].color(lefts[0])

    def cloud(
        self, lefts: Sequence[NDArray[Any]], rights: Sequence[NDArray[Any]], stride: int, watch: Stopwatch
    ) -> Cloud:
        """The cloud of a set."""
        for side, images in (("left", lefts), ("right", rights)):
            if len(images) != len(self._reconstructors):
                raise ImageError(
                    f"{len(images)} {side} images of a set of {len(self._reconstructors)}; expected one each"
                )
        first, second = self._reconstructors
        decided = first.orders(lefts[0], rights[0], watch)
        other, _, other_order = second.orders(lefts[1], rights[1], watch)
        left, right, order = decided
        agreed_orders(
            len(order), order, left.phase, left.descriptors, left.valid, other_order, other.phase, other.descriptors,
            other.valid, self._ratio, WORST_DEVIATION, self._order, self._deviation, self._lit,
        )  # fmt: skip
        moved = temporal_unwrapping.reject_moved(
            self._order, self._unused, self._lit, self._deviation, left.variance, np.float32(0.5), WORST_DEVIATION,
            self._absolute_phase,
        )  # fmt: skip
        watch.lap("agreement")
        cloud = first.stage(stride).cloud(left, right, self._order, first.correction, watch)
        return replace(cloud, moved=int(moved))
