"""A reconstructor whose verdict on a pair depends on that pair and on the first pair's column scan, on nothing between.

The live check chooses its surface patches by a random generator that runs on from pair to pair, and keeps the newest
column scan for later pairs. Both would make the verdict on a pair, and so whether its points are withheld, depend on
every pair before it: a recording could not be split without changing results.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from pipeline.monitor.check.checked_reconstructor import CheckedReconstructor, FirstPair
from pipeline.reconstruct.cloud import Cloud


class IndependentVerdicts(CheckedReconstructor):
    """Reconstructs pairs and judges each one by a check of its own.

    A pair that the first pair's column scan does not show to be consistent, or whose order search costs more or less,
    is scanned itself. The first pair that is not refuted counts as the first one.
    """

    def _judged(self, left: NDArray[Any], right: NDArray[Any], make: Callable[[], Cloud]) -> Cloud:
        before = FirstPair.of(self.inner)
        cloud = make()
        found = self.new_check().check(left, right, cloud, self.inner.scan)
        if found.verdict in ("doubtful", "inconsistent") or self.cost_has_changed():
            found = self.new_check().check(left, right, cloud, self.inner.scan_columns())
        if not before.measured and found.verdict == "inconsistent":
            before.restore(self.inner)
        return replace(cloud, consistency=found)
