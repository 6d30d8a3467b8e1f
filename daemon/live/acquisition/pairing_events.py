"""What leaves the pairing: pairs, and the outcomes of frames without a partner; and its limits."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from daemon.live.items import Pair
from drivers.protocols import Frame


class FrameOutcome(StrEnum):
    """Outcome of a frame; every frame that is received has exactly one."""

    PAIRED = "paired"
    PARTNER_MISSING = "partner_missing"
    LATE = "late"
    DUPLICATE = "duplicate"
    TRIGGER_MISMATCH = "trigger_mismatch"
    TIMESTAMP_MISMATCH = "timestamp_mismatch"
    AMBIGUOUS = "ambiguous"
    STALE = "stale"
    BEFORE_SYNC = "before_sync"
    ROOM_FULL = "room_full"
    STOPPED = "stopped"


RECORDED_UNPAIRED = frozenset(
    {FrameOutcome.PARTNER_MISSING, FrameOutcome.LATE, FrameOutcome.ROOM_FULL, FrameOutcome.BEFORE_SYNC}
)
"""Outcomes of frames whose partner is missing; only the recorder takes these frames."""


@dataclass(frozen=True, slots=True)
class PairingSettings:
    """Limits of the pairing.

    Args:
        tolerance_ns: how far the two exposures' starts may lie apart.
        max_wait_ns: how long a frame waits for its partner.
        stale_ns: a frame that is older than this on arrival is rejected.
        resync_after: observations in a row of another shift between the counters that confirm it.
        capacity: frames waiting, each side; history: frames remembered after their outcome, each side.
    """

    tolerance_ns: int = 2_000_000
    max_wait_ns: int = 500_000_000
    stale_ns: int = 5_000_000_000
    resync_after: int = 3
    capacity: int = 8
    history: int = 256


@dataclass(frozen=True, slots=True, eq=False)
class Lost:
    """A frame that will never be in a pair, and why; it carries its number on the common count."""

    frame: Frame
    outcome: FrameOutcome


@dataclass(frozen=True, slots=True)
class Resynced:
    """The shift between the two counters changed: ``right number - left number`` is now ``shift``."""

    shift: int


Event = Pair | Lost | Resynced
