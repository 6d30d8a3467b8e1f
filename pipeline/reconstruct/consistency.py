"""Whether a pair of images agrees with the calibration: the verdict that travels with a cloud."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Verdict = Literal["consistent", "doubtful", "inconsistent", "unknown"]


@dataclass(frozen=True, slots=True)
class Reading:
    """A number and its standard deviation."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True)
class Consistency:
    """The verdict on one pair.

    Args:
        verdict: ``unknown`` where the scene shows too little surface to decide.
        readings: what was measured, by name; see :data:`pipeline.monitor.consistency.LIMITS`.
        findings: one sentence for each reading beyond its limit: name, value, limit.
        cause: which device moved, about which axis and by how much, as far as the data separate them; else empty.
    """

    verdict: Verdict
    readings: dict[str, Reading] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    cause: str = ""

    @property
    def reason(self) -> str:
        """Cause and findings in one line."""
        return "; ".join((*([self.cause] if self.cause else []), *self.findings))


@dataclass(frozen=True, slots=True)
class ColumnScan:
    """Cost of the fringe order search against the offset of the projector columns, of one pair.

    Args:
        offset_px: offset with the least cost within half a fringe period.
        cost: mean least cost there.
        allowed_px: offset with the least cost among those that a drift of the projector explains.
        allowed_cost: mean least cost there.
        typical_cost: median over all offsets: the cost of unrelated phases in this scene.
    """

    offset_px: float
    cost: float
    allowed_px: float
    allowed_cost: float
    typical_cost: float
