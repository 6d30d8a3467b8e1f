"""A reconstructor whose clouds carry the verdict on the calibration, and hold no point where it is refuted.

Patches alone do not refute every disturbance: where most points are wrong, the filters leave those that agree. The
order search's cost at the correction in use grows with every disturbance that makes points wrong, so it is measured on
every pair; where it has changed since the last column scan, this pair is scanned itself.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import PipelineError
from pipeline.monitor import observe
from pipeline.monitor.check.consistency import ConsistencyCheck
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import CloudFilters
from pipeline.reconstruct.column_correction import CorrectionState
from pipeline.reconstruct.consistency import ColumnScan, Consistency
from pipeline.reconstruct.reconstructor import Reconstructor

Policy = Literal["withhold", "warn", "off"]
_PAIRS = 8
"""Pairs from a column scan to the next of pairs that are not consistent, for which a refutation counts, and after which
the columns are measured again."""
_MOST_SCANS = 4
"""Scans that may follow each other at once because the cost has changed; one more is allowed every :data:`_PAIRS`."""
CHANGED = 0.05
"""Change of the cost at the correction in use, relative to that of unrelated phases, for which a scan is made. Scenes
of one rig differ by up to 0.06, over-exposed ones by more; turns that make points wrong change it by 0.04 to 2.6."""


class CheckedReconstructor:
    """Reconstructs like :class:`Reconstructor` and judges every pair; not for use from two threads at once.

    A refutation counts for the next pairs too. While pairs are refuted, every eighth, and the next one where the
    columns have moved or one camera's brightness has changed, is measured like a first pair: a projector's drift,
    another exposure time, or a first pair that showed nothing useful, is corrected so.

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
        self._unmeasured = reconstructor.state()
        self._scanned: ColumnScan | None = None
        self._since_scan, self._scans = 0, float(_MOST_SCANS)
        self._refutation: Consistency | None = None
        self._since_refutation = self._withheld = 0
        self._was_right = self._brightness_has_changed = False

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
        make = partial(self.inner.reconstruct, left, right, stride=stride, use_prior=use_prior)
        cloud = make() if self.policy == "off" else self._judged(left, right, make)
        if cloud.consistency is not None and cloud.consistency.verdict == "inconsistent" and self.policy == "withhold":
            cloud = cloud.withheld()
        return cloud if self._filters is None else self._filters.apply(cloud, stride=stride)

    def _judged(self, left: NDArray[Any], right: NDArray[Any], make: Callable[[], Cloud]) -> Cloud:
        """The cloud with its verdict."""
        before = FirstPair.of(self.inner)
        if again := self._is_due() and before.measured and self.inner.settings.self_calibrate:
            self.inner.restore(self._unmeasured)
            self._brightness_has_changed = False
        try:
            cloud = make()
        except PipelineError:
            before.restore(self.inner)
            raise
        found = self._verdict(left, right, cloud)
        # A rig that was consistent has moved by more than a drift if it is doubtful now.
        confirmed = again and (found.verdict == "consistent" or (found.verdict == "doubtful" and not self._was_right))
        if again and not confirmed:
            before.restore(self.inner)
        found = self._after_refutations(found, confirmed=confirmed)
        self._was_right |= found.verdict in ("consistent", "doubtful")
        return replace(cloud, consistency=found)

    def _verdict(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud) -> Consistency:
        """The verdict on a pair of raw images and its cloud, without those on earlier pairs."""
        inner = self.inner
        found = self._check.check(left, right, cloud, inner.scan)
        self._since_scan += 1
        self._scans = min(self._scans + 1 / _PAIRS, _MOST_SCANS)
        if inner.scan is not self._scanned:  # the first pair's
            self._scanned, self._since_scan = inner.scan, 0
        elif self._scan_is_due(found):
            self._since_scan, self._scans = 0, self._scans - 1
            self._scanned = inner.scan = inner.scan_columns() or inner.scan
            self._brightness_has_changed = inner.brightness_has_changed()
            found = self._check.check(left, right, cloud, inner.scan)
        return found

    def cost_has_changed(self) -> bool:
        """Whether the last pair's cost differs from that of the scanned pair."""
        cost, scan = self.inner.current_cost(), self.inner.scan
        return cost is not None and scan is not None and abs(cost - scan.used_relative) > CHANGED

    def _scan_is_due(self, found: Consistency) -> bool:
        if self._since_scan >= _PAIRS and found.verdict in ("doubtful", "inconsistent"):
            return True
        return self._scans >= 1 and self.cost_has_changed()

    def _is_due(self) -> bool:
        """Whether the next pair is measured like a first one: at once after a change of columns or brightness."""
        if self._brightness_has_changed:
            return True
        moved = self._refutation is not None and "scanned_change" in self._refutation.readings
        return self._withheld > 0 and (self._withheld % _PAIRS == 0 or (moved and self._withheld == 1))

    def _after_refutations(self, found: Consistency, *, confirmed: bool) -> Consistency:
        """Refuted as long as one of the last pairs was, unless the pair was measured again and confirmed."""
        if found.verdict == "inconsistent":
            self._refutation, self._since_refutation = found, 0
        elif self._refutation is not None:
            self._since_refutation += 1
            if confirmed or self._since_refutation > _PAIRS:
                self._refutation = None
            else:
                earlier = f"{self._since_refutation} pairs before: {'; '.join(self._refutation.findings)}"
                found = replace(
                    found, verdict="inconsistent", findings=(*found.findings, earlier), cause=self._refutation.cause
                )
        self._withheld = 0 if self._refutation is None else self._withheld + 1
        return found


class FirstPair(NamedTuple):
    """What a first pair sets in a reconstructor."""

    correction: CorrectionState
    scan: ColumnScan | None
    other_shifts: NDArray[np.float64]
    gain: float

    @classmethod
    def of(cls, inner: Reconstructor) -> FirstPair:
        """As it is now."""
        return cls(inner.state(), inner.scan, inner.other_shifts, inner.gain)

    @property
    def measured(self) -> bool:
        """Whether a first pair was found."""
        return self.correction[1]

    def restore(self, inner: Reconstructor) -> None:
        """Bring it back."""
        inner.restore(self.correction)
        inner.scan, inner.other_shifts, inner.gain = self.scan, self.other_shifts, self.gain
