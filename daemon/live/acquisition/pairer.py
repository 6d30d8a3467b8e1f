"""Which left and right frame belong to one exposure: by trigger number and exposure time, never by arrival.

Pure logic: no threads and no clock of its own. A pair needs both witnesses: the trigger numbers agree (up to the
known shift between the two counters) and the exposures began at the same time. One witness alone never makes a pair.

Exposure times are the authority on *which* shift holds: a camera that counted an extra first frame, or restarted its
counter, shows the same difference of numbers at equal times again and again. A shift is believed after
``resync_after`` such sightings in a row, and doubted again at the first contrary sighting or restart of a camera. In
doubt, frames that agree wait in the room until the shift is confirmed, then all of them leave as pairs: a doubt
costs a little delay, never a wrong pair. A frame that contradicts its own camera's last frames (the same number at
another time, or the same time under another number) is in no pair either. ``tolerance_ns`` must be below half the
trigger interval.

Whatever leaves carries the common number, pairs and lost frames alike; when both cameras begin to count anew, it goes
on behind the numbers that were given (:mod:`daemon.live.acquisition.trigger_count`).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import StrEnum
from itertools import islice

from daemon.live.acquisition.trigger_count import TriggerCount
from drivers.protocols import SIDES, TRIGGER_MODULUS, Frame, Side

_HALF = TRIGGER_MODULUS // 2
_CONTRADICTION_WINDOW = 16


class FrameOutcome(StrEnum):
    """What became of a frame; every frame that is fed meets exactly one."""

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
"""Fates of frames whose partner is missing; only a recording wants them."""


@dataclass(frozen=True, slots=True)
class PairingSettings:
    """Limits of the pairing.

    Args:
        tolerance_ns: how far the two exposures' starts may lie apart.
        max_wait_ns: how long a frame waits for its partner.
        stale_ns: a frame that is older than this on arrival is refused.
        resync_after: sightings in a row of another shift between the counters before it is believed.
        room: frames waiting, each side; history: frames remembered after their fate, each side.
    """

    tolerance_ns: int = 2_000_000
    max_wait_ns: int = 500_000_000
    stale_ns: int = 5_000_000_000
    resync_after: int = 3
    room: int = 8
    history: int = 256


@dataclass(frozen=True, slots=True, eq=False)
class Pair:
    """Two frames of one exposure; both carry the same trigger number."""

    left: Frame
    right: Frame

    @property
    def seq(self) -> int:
        """The number of the trigger."""
        return self.left.trigger


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


@dataclass(slots=True, eq=False)
class _Waiting:
    frame: Frame
    number: int
    arrived_ns: int
    same_time: bool = False
    same_number: bool = False
    agreed: bool = False
    ambiguous: bool = False

    @property
    def numbered(self) -> Frame:
        """The frame with its number on the common count."""
        return self.frame if self.frame.trigger == self.number else replace(self.frame, trigger=self.number)


@dataclass(slots=True, eq=False)
class _Camera:
    """One side's waiting room, its memory, and what to add to its trigger numbers."""

    shift: int = 0
    waiting: list[_Waiting] = field(default_factory=list)
    seen: deque[tuple[int, int]] = field(default_factory=deque)
    lapsed: deque[tuple[int, int]] = field(default_factory=deque)
    last_paired: int | None = None

    def move(self, by: int) -> None:
        """Count differently from here on, those who wait included."""
        self.shift = (self.shift + by) % TRIGGER_MODULUS
        for guest in self.waiting:
            guest.number = (guest.number + by) % TRIGGER_MODULUS


class Pairer:
    """Feed frames in the order of arrival; get pairs and the fates of all others.

    ``feed`` and ``tick`` take the time of arrival on any clock that never goes back; without one, the frame's own
    ``t_host_ns`` serves.
    """

    def __init__(self, settings: PairingSettings | None = None) -> None:
        self.settings = settings or PairingSettings()
        self.outcomes: dict[Side, Counter[FrameOutcome]] = {side: Counter() for side in SIDES}
        self.fed: Counter[Side] = Counter()
        self._cameras: dict[Side, _Camera] = {
            side: _Camera(seen=deque(maxlen=self.settings.history), lapsed=deque(maxlen=self.settings.history))
            for side in SIDES
        }
        self._numbering = TriggerCount()
        self._now_ns = 0
        self._synced = False
        self._confirmed = False
        self._sighted_shift = 0
        self._sightings = 0

    @property
    def shift(self) -> int:
        """Right trigger number minus left trigger number, as believed now, modulo 2**32."""
        return (self._cameras["left"].shift - self._cameras["right"].shift) % TRIGGER_MODULUS

    @property
    def counter_restarts(self) -> int:
        """How often both cameras began to count anew."""
        return self._numbering.counter_restarts

    @property
    def waiting(self) -> int:
        """Frames without a fate yet."""
        return sum(len(camera.waiting) for camera in self._cameras.values())

    def feed(self, frame: Frame, now_ns: int | None = None) -> list[Event]:
        """Take one frame; returns what was decided by its coming."""
        self.fed[frame.side] += 1
        events = self.tick(frame.t_host_ns if now_ns is None else now_ns)
        refused = self._refusal(frame)
        mine = self._cameras[frame.side]
        guest = _Waiting(frame, (frame.trigger + mine.shift) % TRIGGER_MODULUS, self._now_ns)
        if refused is not None:
            return [*events, self._lost(guest, refused)]
        self._doubt(mine, guest)
        mine.seen.append((frame.trigger, frame.t_exposure_ns))
        partner = self._partner(guest)
        if partner is not None and self._confirmed:
            return [*events, self._pair(guest, partner)]
        if self._came_late(guest):
            return [*events, self._lost(guest, FrameOutcome.LATE)]
        mine.waiting.append(guest)
        events += self._compare(guest)
        if len(mine.waiting) > self.settings.room:
            events.append(self._lapse(mine, mine.waiting[0], FrameOutcome.ROOM_FULL))
        return events

    def tick(self, now_ns: int) -> list[Event]:
        """Let time pass: frames that waited too long meet their fate."""
        self._now_ns = max(self._now_ns, now_ns)
        oldest_ns = self._now_ns - self.settings.max_wait_ns
        return [
            self._lapse(camera, guest, FrameOutcome.PARTNER_MISSING)
            for camera in self._cameras.values()
            for guest in [guest for guest in camera.waiting if guest.arrived_ns < oldest_ns]
        ]

    def camera_restarted(self, side: Side) -> None:
        """A camera was started anew: its count may have moved or begun again, so it must be confirmed anew."""
        self._confirmed, self._sightings = False, 0
        # What it counted before is no witness against what it counts now.
        self._cameras[side].seen.clear()
        self._cameras[side].lapsed.clear()

    def flush(self) -> list[Event]:
        """The end: every frame still waiting is counted as stopped."""
        everyone = [guest for camera in self._cameras.values() for guest in camera.waiting]
        for camera in self._cameras.values():
            camera.waiting.clear()
        return [self._lost(guest, FrameOutcome.STOPPED) for guest in everyone]

    def _refusal(self, frame: Frame) -> FrameOutcome | None:
        if frame.t_host_ns - frame.t_exposure_ns > self.settings.stale_ns:
            return FrameOutcome.STALE
        known = self._cameras[frame.side].seen
        again = any(number == frame.trigger and self._same_time(t_ns, frame.t_exposure_ns) for number, t_ns in known)
        return FrameOutcome.DUPLICATE if again else None

    def _doubt(self, camera: _Camera, guest: _Waiting) -> None:
        recent = islice(reversed(camera.seen), _CONTRADICTION_WINDOW)
        guest.ambiguous = any(self._contradict(guest, number, t_ns) for number, t_ns in recent)
        for other in camera.waiting:
            other.ambiguous |= self._contradict(guest, other.frame.trigger, other.frame.t_exposure_ns)

    def _contradict(self, guest: _Waiting, number: int, t_ns: int) -> bool:
        return (number == guest.frame.trigger) != self._same_time(t_ns, guest.frame.t_exposure_ns)

    def _same_time(self, a_ns: int, b_ns: int) -> bool:
        return abs(a_ns - b_ns) <= self.settings.tolerance_ns

    def _opposite(self, side: Side) -> _Camera:
        return self._cameras["right" if side == "left" else "left"]

    def _partner(self, guest: _Waiting) -> _Waiting | None:
        for other in self._opposite(guest.frame.side).waiting:
            if other.ambiguous or guest.ambiguous:
                continue
            if other.number == guest.number and self._same_time(other.frame.t_exposure_ns, guest.frame.t_exposure_ns):
                return other
        return None

    def _came_late(self, guest: _Waiting) -> bool:
        gone = self._opposite(guest.frame.side).lapsed
        return any(number == guest.number and self._same_time(t_ns, guest.frame.t_exposure_ns) for number, t_ns in gone)

    def _pair(self, guest: _Waiting, partner: _Waiting) -> Pair:
        self._opposite(guest.frame.side).waiting.remove(partner)
        self._synced, self._sightings = True, 0
        self._count_on(guest, partner)
        self._numbering.gave(guest.number, guest.frame.t_exposure_ns, paired=True)
        frames: dict[Side, Frame] = {}
        for member in (guest, partner):
            side = member.frame.side
            self.outcomes[side][FrameOutcome.PAIRED] += 1
            self._cameras[side].last_paired = member.number
            frames[side] = member.numbered
        return Pair(frames["left"], frames["right"])

    def _count_on(self, guest: _Waiting, partner: _Waiting) -> None:
        """If both cameras began to count anew: move the numbers of everyone behind those that were given."""
        waiting = [other.number for camera in self._cameras.values() for other in camera.waiting]
        move = self._numbering.move(guest.number, guest.frame.t_exposure_ns, waiting)
        if not move:
            return
        for camera in self._cameras.values():
            camera.move(move)
            camera.lapsed.clear()
        for member in (guest, partner):
            member.number = (member.number + move) % TRIGGER_MODULUS

    def _compare(self, guest: _Waiting) -> list[Event]:
        """Note what speaks for and against a pair with those who wait; enough equal sightings settle the shift."""
        together = []
        for other in self._opposite(guest.frame.side).waiting:
            number = other.number == guest.number
            time = self._same_time(other.frame.t_exposure_ns, guest.frame.t_exposure_ns)
            for member in (guest, other):
                member.agreed |= number and time
                member.same_number |= number and not time
                member.same_time |= time and not number
            together += [other] if time else []
        if len(together) != 1:
            return []
        left, right = (guest, together[0]) if guest.frame.side == "left" else (together[0], guest)
        return self._sight(left, right)

    def _sight(self, left: _Waiting, right: _Waiting) -> list[Event]:
        shift = (right.number - left.number) % TRIGGER_MODULUS
        self._sightings = self._sightings + 1 if shift == self._sighted_shift else 1
        self._sighted_shift = shift
        if shift:
            self._confirmed = False
        if self._sightings < self.settings.resync_after:
            return []
        resynced = self._resync(left, right, shift) if shift else []
        self._confirmed = True
        return [*resynced, *self._pair_waiting()]

    def _resync(self, left: _Waiting, right: _Waiting, shift: int) -> list[Event]:
        """Believe the new shift: move the numbers of the side that jumped."""
        jumped: Side = "left" if self._went_back("left", left) and not self._went_back("right", right) else "right"
        camera = self._cameras[jumped]
        move = shift if jumped == "left" else -shift
        camera.move(move)
        camera.lapsed.clear()
        self._sightings = self._sighted_shift = 0
        return [Resynced(self.shift)]

    def _went_back(self, side: Side, guest: _Waiting) -> bool:
        last = self._cameras[side].last_paired
        return last is not None and not 0 < (guest.number - last) % TRIGGER_MODULUS < _HALF

    def _pair_waiting(self) -> Iterator[Event]:
        for guest in list(self._cameras["left"].waiting):
            partner = self._partner(guest)
            if partner is not None:
                self._cameras["left"].waiting.remove(guest)
                yield self._pair(guest, partner)

    def _lapse(self, camera: _Camera, guest: _Waiting, otherwise: FrameOutcome) -> Lost:
        camera.waiting.remove(guest)
        camera.lapsed.append((guest.number, guest.frame.t_exposure_ns))
        if guest.agreed:
            outcome = FrameOutcome.AMBIGUOUS if guest.ambiguous else FrameOutcome.BEFORE_SYNC
        elif guest.same_time:
            outcome = FrameOutcome.TRIGGER_MISMATCH
        elif guest.same_number:
            outcome = FrameOutcome.TIMESTAMP_MISMATCH
        else:
            outcome = otherwise if self._synced else FrameOutcome.BEFORE_SYNC
        return self._lost(guest, outcome)

    def _lost(self, guest: _Waiting, outcome: FrameOutcome) -> Lost:
        self.outcomes[guest.frame.side][outcome] += 1
        if outcome in RECORDED_UNPAIRED:
            self._numbering.gave(guest.number, guest.frame.t_exposure_ns, paired=False)
        return Lost(guest.numbered, outcome)
