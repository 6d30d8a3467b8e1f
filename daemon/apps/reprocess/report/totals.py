"""Totals of a run while it works: by recording, and over all; their size does not grow with the number of pairs."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from daemon.apps.reprocess.plan.chunk_plan import TakePlan
from daemon.apps.reprocess.work.chunk_work import ChunkOutcome

BINS: dict[str, tuple[float, ...]] = {
    "coverage": tuple(n / 20 for n in range(21)),
    "rejected": tuple(n / 20 for n in range(21)),
    "total_ms": tuple(round(10 ** (1 + n / 8), 1) for n in range(25)),
}
"""Edges of the histograms; the first and the last bin hold what lies beyond."""


@dataclass(slots=True)
class Sums:
    """Sums over clouds: their number, points, shares, milliseconds, verdicts and histograms."""

    clouds: int = 0
    failed: int = 0
    points: int = 0
    coverage: float = 0.0
    rejected: float = 0.0
    total_ms: float = 0.0
    seconds: float = 0.0
    verdicts: Counter[str] = field(default_factory=Counter)
    histograms: dict[str, NDArray[np.int64]] = field(
        default_factory=lambda: {name: np.zeros(len(edges) - 1, np.int64) for name, edges in BINS.items()}
    )

    @classmethod
    def of(cls, outcome: ChunkOutcome) -> Sums:
        """The sums of one chunk."""
        out = cls(
            len(outcome.points), outcome.failed, sum(outcome.points), sum(outcome.coverage), sum(outcome.rejected),
            sum(outcome.total_ms), outcome.seconds, Counter(v for v in outcome.verdicts if v),
        )  # fmt: skip
        for name, edges in BINS.items():
            values = np.clip(getattr(outcome, name), edges[0], edges[-1])
            out.histograms[name] = np.histogram(values, edges)[0]
        return out

    def add(self, other: Sums) -> None:
        """Add the sums of other clouds."""
        for name in ("clouds", "failed", "points", "coverage", "rejected", "total_ms", "seconds"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        self.verdicts.update(other.verdicts)
        for name, counts in other.histograms.items():
            self.histograms[name] = self.histograms[name] + counts

    def means(self) -> dict[str, Any]:
        """Figures of one cloud on average."""
        n = max(1, self.clouds)
        return {
            "clouds": self.clouds,
            "failed": self.failed,
            "points": round(self.points / n, 1),
            "coverage": round(self.coverage / n, 6),
            "rejected": round(self.rejected / n, 6),
            "ms": round(self.total_ms / n, 3),
            "verdicts": dict(self.verdicts),
        }


@dataclass(slots=True)
class TakeTotals:
    """A recording of the run.

    Args:
        items: pairs or sets; done: those with a result, resumed: of these, those from an earlier run.
        problems: damage of the recording; failures: what has no result, and why.
    """

    name: str
    url: str
    items: int = 0
    bytes: int = 0
    mode: str = ""
    done: int = 0
    resumed: int = 0
    damaged: int = 0
    incomplete: int = 0
    unpaired: int = 0
    sums: Sums = field(default_factory=Sums)
    problems: list[str] = field(default_factory=list)
    failures: list[str] = field(default_factory=list)
    _chunks: dict[int, tuple[Sums, int, bool]] = field(default_factory=dict)

    def begin(self, plan: TakePlan) -> None:
        """Copy the figures of the plan."""
        self.items, self.bytes, self.mode = plan.items, plan.bytes, plan.mode
        self.damaged, self.incomplete, self.unpaired = plan.damaged, plan.incomplete, sum(plan.unpaired.values())
        self.problems = list(plan.problems)

    def add(self, number: int, outcome: ChunkOutcome, items: int, *, resumed: bool = False) -> None:
        """Add a chunk's result; a second one replaces the first."""
        self._chunks[number] = Sums.of(outcome), items, resumed

    def close(self) -> None:
        """Sum up the chunks."""
        for sums, items, resumed in self._chunks.values():
            self.sums.add(sums)
            self.done += items
            self.resumed += items * resumed
        self._chunks.clear()

    def as_json(self) -> dict[str, Any]:
        """Plain values for the report."""
        out = {name: getattr(self, name) for name in self.__slots__ if name not in ("sums", "_chunks")}
        return out | self.sums.means() | {"seconds": round(self.sums.seconds, 3)}


@dataclass(slots=True)
class Totals:
    """A run.

    Args:
        recordings: number of all; closed: those that are over.
        items, bytes: of the recordings planned so far; done: items with a result; computed: of these, those of this
            run.
    """

    recordings: int = 0
    items: int = 0
    bytes: int = 0
    done: int = 0
    computed: int = 0
    closed: list[TakeTotals] = field(default_factory=list)
    sums: Sums = field(default_factory=Sums)

    def planned(self, take: TakeTotals) -> None:
        """A recording was planned; what is finished of it counts as done."""
        self.items += take.items
        self.bytes += take.bytes
        self.done += sum(items for _, items, _ in take._chunks.values())

    def forget(self, take: TakeTotals) -> None:
        """A recording is planned again."""
        self.items -= take.items
        self.bytes -= take.bytes
        self.done -= sum(items for _, items, _ in take._chunks.values())

    def advanced(self, items: int) -> None:
        """A chunk was computed."""
        self.done += items
        self.computed += items

    def close(self, take: TakeTotals) -> None:
        """A recording is over."""
        take.close()
        self.sums.add(take.sums)
        self.closed.append(take)

    @property
    def failures(self) -> list[str]:
        """One sentence for everything without a result."""
        return [f"{take.name}: {reason}" for take in self.closed for reason in take.failures]
