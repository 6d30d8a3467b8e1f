"""A reconstructor whose verdict on a pair depends on that pair and on the first pair's column scan, on nothing between.

The live check chooses its surface patches by a random generator that runs on from pair to pair, and keeps the newest
column scan for later pairs. Both would make the verdict on a pair, and so whether its points are withheld, depend on
every pair before it: a recording could not be split without changing results.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from pipeline.monitor import observe
from pipeline.monitor.checked_reconstructor import Policy
from pipeline.monitor.consistency import ConsistencyCheck
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import CloudFilters
from pipeline.reconstruct.consistency import ColumnScan, Consistency
from pipeline.reconstruct.reconstructor import Reconstructor


class IndependentVerdicts:
    """Reconstructs pairs and judges each one; arguments as of ``CheckedReconstructor``.

    A pair that the first pair's column scan does not show to be consistent is scanned itself.
    """

    def __init__(
        self, reconstructor: Reconstructor, policy: Policy = "withhold", filters: CloudFilters | None = None
    ) -> None:
        self.inner, self.policy, self._filters = reconstructor, policy, filters

    @property
    def encoding(self) -> str:
        """Encoding of the raw images."""
        return self.inner.encoding

    def warm_up(self, *, strides: tuple[int, ...] = (1,), use_prior: bool = False) -> None:
        """As of the reconstructor."""
        self.inner.warm_up(strides=strides, use_prior=use_prior)
        if self.policy != "off":
            observe.warm_up()

    def reconstruct(self, left: NDArray[Any], right: NDArray[Any], /, *, use_prior: bool = False) -> Cloud:
        """The cloud of a pair with its consistency; arguments and errors as of the reconstructor."""
        cloud = self._judged(left, right, use_prior=use_prior)
        return cloud if self._filters is None else self._filters.apply(cloud)

    def _judged(self, left: NDArray[Any], right: NDArray[Any], *, use_prior: bool) -> Cloud:
        cloud = self.inner.reconstruct(left, right, use_prior=use_prior)
        if self.policy == "off":
            return cloud
        found = self._verdict(left, right, cloud, self.inner.scan)
        if found.verdict in ("doubtful", "inconsistent"):
            found = self._verdict(left, right, cloud, self.inner.scan_columns())
        cloud = replace(cloud, consistency=found)
        return cloud.withheld() if self.policy == "withhold" and found.verdict == "inconsistent" else cloud

    def _verdict(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud, scan: ColumnScan | None) -> Consistency:
        """Judge by a check of its own, whose choice of patches starts from the seed."""
        inner = self.inner
        check = ConsistencyCheck(
            inner.calibration, inner.pattern, inner.volume, encoding=inner.encoding, settings=inner.settings
        )
        return check.check(left, right, cloud, scan)
