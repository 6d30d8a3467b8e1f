"""Whether a pair of images agrees with the calibration: the verdict that travels with a cloud."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.reconstruct.column_correction import OffsetLikelihood

F64 = NDArray[np.float64]
Verdict = Literal["consistent", "doubtful", "inconsistent", "unknown"]

LEAST_PIXELS = 200
"""Pixels with two candidates from which costs are averaged."""
CLEARLY_LESS = 0.9
"""Mean cost at a displacement of the right image, relative to that without, below which it counts: intact rigs of all
scenes have the least cost at 0, a pitch of 0.02 degrees gives 0.88, one of 0.05 degrees 0.7."""
NOISE_COST = 0.005
"""Lower quartile of the costs that noise alone gives. Where many orders fit into the volume, the least cost of
unrelated phases is only a few times as much."""


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
        readings: what was measured, by name; see :data:`pipeline.monitor.check.limits.LIMITS`.
        findings: one sentence for each reading beyond its limit: name, value, limit.
        cause: which device moved, about which axis and by how much, as far as the data separate them; else empty.
    """

    verdict: Verdict
    readings: dict[str, Reading] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    cause: str = ""

    def as_mapping(self) -> dict[str, Any]:
        """Plain values for files and messages: verdict, reason, and value and sigma of each reading."""
        # Encoders of messages refuse numpy's floats, which arithmetic of the readings may give.
        readings = {name: [round(float(x), 5) for x in (one.value, one.sigma)] for name, one in self.readings.items()}
        return {"verdict": self.verdict, "reason": self.reason, "readings": readings}

    @property
    def reason(self) -> str:
        """Cause and findings in one line."""
        return "; ".join((*([self.cause] if self.cause else []), *self.findings))


@dataclass(frozen=True, slots=True)
class ColumnScan:
    """Cost of the fringe order search against displacements of the projector and of the right camera, of one pair.

    Args:
        offset_px: offset with the least mean cost within half a fringe period.
        cost: mean least cost of the pixels there.
        allowed_px: offset with the least cost among those that a drift of the projector explains.
        allowed_cost: mean least cost there.
        relative_cost: lower quartile of the pixels' costs at ``allowed_px`` over the median of that quartile over all
            offsets, each less :data:`NOISE_COST`: 0 = every pixel agrees, 1 = no better than unrelated phases.
        across_px: displacement of the right image across the epipolar lines with clearly the least cost, else 0.
        gain: of :class:`pipeline.reconstruct.column_correction.OffsetLikelihood` at the correction in use.
        used_px: the correction in use, in the middle of the projector.
        used_cost: mean least cost there.
        used_relative: as ``relative_cost``, there.
        unrelated: lower quartile of the pixels' costs at most offsets.
    """

    offset_px: float
    cost: float
    allowed_px: float
    allowed_cost: float
    relative_cost: float
    across_px: float = 0.0
    gain: float = 0.0
    used_px: float = 0.0
    used_cost: float = 0.0
    used_relative: float = 0.0
    unrelated: float = 0.0

    @classmethod
    def of(
        cls,
        offsets: F64,
        costs: Sequence[NDArray[np.float32]],
        largest: float,
        across: Mapping[int, float],
        corrected: NDArray[np.float32],
        used_px: float,
        used_quartile: float,
    ) -> ColumnScan | None:
        """The scan of (n,) offsets with the costs of the pixels at each; None where no pixel has two candidates.

        Args:
            largest: offset that a drift of the projector explains.
            across: mean least cost by displacement across the epipolar lines, pixels; 0 among them.
            corrected: costs of the pixels at the correction in use, which is ``used_px`` in the middle.
            used_quartile: the lower quartile there, of the same pixels as later pairs' costs; NaN = too few.
        """
        if min(map(len, costs)) < LEAST_PIXELS or not np.isfinite(used_quartile):
            return None
        means = np.array([cost.mean(dtype=np.float64) for cost in costs])
        quartiles = np.array([np.quantile(cost, 0.25) for cost in costs])
        best = int(means.argmin())
        allowed = int(np.where(np.abs(offsets) <= largest, means, np.inf).argmin())
        unrelated = float(np.median(quartiles))
        displaced = min(across, key=across.__getitem__)
        return cls(
            float(offsets[best]), float(means[best]), float(offsets[allowed]), float(means[allowed]),
            relative_cost(quartiles[allowed], unrelated),
            float(displaced) if across[displaced] < CLEARLY_LESS * across[0] else 0.0,
            float(OffsetLikelihood.of(np.append(offsets, 0.0), [*costs, corrected]).gain[-1]),
            used_px, float(corrected.mean(dtype=np.float64)),
            relative_cost(used_quartile, unrelated), unrelated,
        )  # fmt: skip


def relative_cost(quartile: float, unrelated: float) -> float:
    """Lower quartile of costs over that of unrelated phases, each less :data:`NOISE_COST`."""
    return float(max(quartile - NOISE_COST, 0.0) / max(unrelated - NOISE_COST, 1e-6))
