"""A reconstructor whose verdict on a pair depends on that pair and on the first pair's column scan, on nothing between.

The live check chooses its surface patches by a random generator that runs on from pair to pair, and keeps the newest
column scan for later pairs. Both would make the verdict on a pair, and so whether its points are withheld, depend on
every pair before it: a recording could not be split without changing results.
"""

from __future__ import annotations

from typing import Any

from numpy.typing import NDArray

from pipeline.monitor.checked_reconstructor import CheckedReconstructor
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.consistency import Consistency


class IndependentVerdicts(CheckedReconstructor):
    """Reconstructs pairs and judges each one by a check of its own.

    A pair that the first pair's column scan does not show to be consistent is scanned itself.
    """

    def verdict(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud) -> Consistency:
        """The verdict on a pair of raw images and its cloud."""
        found = self.new_check().check(left, right, cloud, self.inner.scan)
        if found.verdict in ("doubtful", "inconsistent"):
            found = self.new_check().check(left, right, cloud, self.inner.scan_columns())
        return found
