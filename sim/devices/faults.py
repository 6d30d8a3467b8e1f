"""Faults of frames and cameras: a plan by trigger, scripted or drawn from a seed, and a ledger of the outcomes.

The plan is a pure function of the trigger's index (0 for the first one of a run), so the same plan gives the same
faults at any speed.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from drivers.protocols import SIDES, Side


class FaultKind(StrEnum):
    """A fault, or none."""

    NONE = "none"
    LOST = "lost"  # this side's frame never arrives
    LATE = "late"  # it arrives ``length`` triggers later, after newer ones
    DUPLICATE = "duplicate"  # it arrives twice
    EXTRA_FIRST = "extra_first"  # one frame too many before the first trigger
    WRONG_NUMBER = "wrong_number"  # its trigger number is off by ``length``
    BLACKOUT = "blackout"  # no frame on either side for ``length`` triggers
    GONE = "gone"  # the camera is unplugged for ``length`` triggers


# Those that can be drawn at random; extra_first occurs once a run or never.
RANDOM_KINDS = (
    FaultKind.LOST,
    FaultKind.LATE,
    FaultKind.DUPLICATE,
    FaultKind.WRONG_NUMBER,
    FaultKind.BLACKOUT,
    FaultKind.GONE,
)
_LENGTHS = {FaultKind.LATE: 2, FaultKind.WRONG_NUMBER: 1, FaultKind.BLACKOUT: 3, FaultKind.GONE: 20}
_SPANNING = (FaultKind.GONE, FaultKind.BLACKOUT)


@dataclass(frozen=True, slots=True)
class Fault:
    """One fault: from trigger ``at``; ``side`` None means both; the meaning of ``length`` depends on the kind."""

    kind: FaultKind
    at: int
    side: Side | None = None
    length: int = 1

    def __post_init__(self) -> None:
        if self.length == 0 or (self.length < 0 and self.kind is not FaultKind.WRONG_NUMBER):
            raise ValueError(f"faults: {self.kind} at {self.at} has length {self.length}, expected at least 1")

    def affects(self, index: int, side: Side) -> bool:
        """Whether the fault affects this trigger and side."""
        if self.side not in (None, side):
            return False
        span = self.length if self.kind in _SPANNING else 1
        return self.at <= index < self.at + span


_NO_FAULT = Fault(FaultKind.NONE, 0)


@dataclass(frozen=True, slots=True)
class FaultPlan:
    """Scripted faults, and others drawn with a rate per trigger and side.

    Args:
        scripted: have precedence over drawn ones.
        rates: fraction of triggers, 0..1, by kind.
        seed: of the drawn faults.
    """

    scripted: tuple[Fault, ...] = ()
    rates: Mapping[FaultKind, float] = field(default_factory=dict)
    seed: int = 0

    def __post_init__(self) -> None:
        for kind, rate in self.rates.items():
            if kind not in RANDOM_KINDS:
                raise ValueError(f"faults.{kind} cannot be drawn at random; there are {', '.join(RANDOM_KINDS)}")
            if not 0 <= rate <= 1:
                raise ValueError(f"faults.{kind} is {rate}, expected a fraction of the triggers from 0 to 1")

    @classmethod
    def none(cls) -> FaultPlan:
        """A plan without faults."""
        return cls()

    @classmethod
    def script(cls, faults: Iterable[Fault]) -> FaultPlan:
        """A plan of exactly these faults."""
        return cls(scripted=tuple(faults))

    @classmethod
    def random(cls, seed: int, rate: float = 0.01, *, extra_first: Side | None = None, **rates: float) -> FaultPlan:
        """Every kind at ``rate``, but a tenth of that for blackouts and lost cameras; ``rates`` override by name."""
        drawn = {kind: rate / 10 if kind in _SPANNING else rate for kind in RANDOM_KINDS}
        drawn |= {FaultKind(name): value for name, value in rates.items()}
        scripted = () if extra_first is None else (Fault(FaultKind.EXTRA_FIRST, 0, extra_first),)
        return cls(scripted, drawn, seed)

    def of(self, index: int, side: Side) -> Fault:
        """The fault of a trigger's frame on one side, or one of kind ``none``; a lost camera has precedence."""
        affecting = [f for f in self.scripted if f.kind is not FaultKind.EXTRA_FIRST and f.affects(index, side)]
        spanning = [f for f in affecting if f.kind in _SPANNING] or self._drawn_spans(index, side)
        if spanning:
            return spanning[0]
        return affecting[0] if affecting else self._drawn(index, side)

    def gone(self, index: int, side: Side) -> bool:
        """Whether the camera is unplugged at this trigger."""
        return self.of(index, side).kind is FaultKind.GONE

    def extra_first(self, side: Side) -> bool:
        """Whether this side sends an extra frame before the first trigger."""
        return any(f.kind is FaultKind.EXTRA_FIRST and f.side in (None, side) for f in self.scripted)

    def _drawn_spans(self, index: int, side: Side) -> list[Fault]:
        for kind in _SPANNING:
            rate = self.rates.get(kind, 0.0)
            who = SIDES.index(side) if kind is FaultKind.GONE else 2
            for at in range(max(0, index - _LENGTHS[kind] + 1), index + 1) if rate > 0 else ():
                if _chance(self.seed, at, who, kind) < rate:
                    return [Fault(kind, at, side if kind is FaultKind.GONE else None, _LENGTHS[kind])]
        return []

    def _drawn(self, index: int, side: Side) -> Fault:
        for kind in RANDOM_KINDS:
            if kind not in _SPANNING and _chance(self.seed, index, SIDES.index(side), kind) < self.rates.get(kind, 0.0):
                return Fault(kind, index, side, _LENGTHS.get(kind, 1))
        return _NO_FAULT


def _chance(seed: int, index: int, who: int, kind: FaultKind) -> float:
    """A uniform number in [0, 1), a hash of all arguments (SplitMix64)."""
    mask = (1 << 64) - 1
    z = (seed * 0x9E3779B97F4A7C15 + index * 0xD1B54A32D192ED03 + (3 * RANDOM_KINDS.index(kind) + who + 1)) & mask
    for _ in range(2):
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        z ^= z >> 31
    return z / 2**64


@dataclass(frozen=True, slots=True)
class Entry:
    """One event: ``index`` of the trigger, ``number`` that the frame carries, and its outcome."""

    index: int
    number: int
    side: Side
    outcome: str


class Ledger:
    """Outcome of every frame, counted by side and outcome; entries are kept on request.

    Outcomes: ``sent`` (entered the camera's queue), the names of faults, ``not_listening`` (the camera was not
    acquiring), ``overflow`` (displaced from the queue unread), ``dropped`` (unread when the camera stopped or was
    lost). Late frames not yet delivered are the world's ``pending``.
    """

    def __init__(self, *, keep_entries: bool = False) -> None:
        self._lock = threading.Lock()
        self.counts: Counter[tuple[Side, str]] = Counter()
        self.entries: list[Entry] | None = [] if keep_entries else None

    def note(self, index: int, number: int, side: Side, outcome: str) -> None:
        """Record one event."""
        with self._lock:
            self.counts[side, outcome] += 1
            if self.entries is not None:
                self.entries.append(Entry(index, number, side, outcome))

    def of(self, outcome: str) -> list[Entry]:
        """All kept entries of one outcome, in order."""
        return [entry for entry in self.entries or () if entry.outcome == outcome]
