"""A reconstructor whose clouds carry the verdict on the calibration, and hold no point where it is refuted."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.monitor import observe
from pipeline.monitor.consistency import ConsistencyCheck
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import CloudFilters
from pipeline.reconstruct.consistency import Consistency
from pipeline.reconstruct.reconstructor import Reconstructor

Policy = Literal["withhold", "warn", "off"]
_RESCAN_PAIRS = 8


class CheckedReconstructor:
    """Reconstructs like :class:`Reconstructor` and judges every pair; not for use from two threads at once.

    Args:
        reconstructor: makes the clouds.
        policy: ``withhold`` = a cloud of an inconsistent pair has no points; ``warn`` = it keeps them; ``off``.
        filters: of the judged clouds, None = none.
    """

    def __init__(
        self, reconstructor: Reconstructor, policy: Policy = "withhold", filters: CloudFilters | None = None
    ) -> None:
        self.inner, self.policy, self._filters = reconstructor, policy, filters
        self._check = self.new_check()
        self._since_scan = 0

    @property
    def mode(self) -> str:
        """The mode whose images it reconstructs."""
        return self.inner.mode

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras."""
        return self.inner.warnings

    @property
    def encoding(self) -> str:
        """Encoding of the raw images."""
        return self.inner.encoding

    def new_check(self) -> ConsistencyCheck:
        """A check in its first state: its choice of surface patches starts from the seed."""
        inner = self.inner
        return ConsistencyCheck(
            inner.calibration, inner.pattern, inner.volume, encoding=inner.encoding, settings=inner.settings
        )

    def warm_up(self, *, strides: tuple[int, ...] = (1,), use_prior: bool = False) -> None:
        """As of the reconstructor."""
        self.inner.warm_up(strides=strides, use_prior=use_prior)
        if self.policy != "off":
            observe.warm_up(parallel=True)

    def color(self, left: NDArray[Any]) -> NDArray[np.uint8]:
        """The fringe-free colour of a left raw image, on the grid of the clouds."""
        color = self.inner.color(left)
        return color if self._filters is None else self._filters.texture(color)

    def reconstruct(
        self, left: NDArray[Any], right: NDArray[Any], /, *, stride: int = 1, use_prior: bool = False
    ) -> Cloud:
        """The cloud of a pair with its consistency; arguments and errors as of the reconstructor."""
        cloud = self._judged(left, right, stride=stride, use_prior=use_prior)
        return cloud if self._filters is None else self._filters.apply(cloud, stride=stride)

    def _judged(self, left: NDArray[Any], right: NDArray[Any], *, stride: int, use_prior: bool) -> Cloud:
        cloud = self.inner.reconstruct(left, right, stride=stride, use_prior=use_prior)
        if self.policy == "off":
            return cloud
        found = self.verdict(left, right, cloud)
        cloud = replace(cloud, consistency=found)
        return cloud.withheld() if self.policy == "withhold" and found.verdict == "inconsistent" else cloud

    def verdict(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud) -> Consistency:
        """The verdict on a pair of raw images and its cloud."""
        found = self._check.check(left, right, cloud, self.inner.scan)
        self._since_scan += 1
        if found.verdict in ("doubtful", "inconsistent") and self._since_scan >= _RESCAN_PAIRS:
            # The scan is of an earlier pair: what has moved since then shows in a new one.
            self._since_scan = 0
            self.inner.scan = self.inner.scan_columns()
            found = self._check.check(left, right, cloud, self.inner.scan)
        return found
