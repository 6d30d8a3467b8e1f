"""Pairing of left and right frames by trigger number and exposure time, never by order of arrival.

Pure logic: no threads and no clock of its own. A pair needs two criteria: the trigger numbers agree (up to the known
shift between the two counters) and the exposures began at the same time. One of them alone never makes a pair.

Exposure times decide *which* shift holds: a camera that counted an extra first frame, or restarted its counter, shows
the same difference of numbers at equal times again and again. A shift is confirmed by ``resync_after`` such
observations in a row, and unconfirmed at the first contrary observation or restart of a camera. While it is
unconfirmed, frames that agree wait until the shift is confirmed, then all of them leave as pairs: that costs a little
delay, never a wrong pair. A frame that contradicts its own camera's last frames (the same number at another time, or
the same time under another number) is in no pair either. ``tolerance_ns`` must be below half the trigger interval.

Whatever leaves carries the common number, pairs and lost frames alike; after a restart of both counters it continues
behind the numbers that were assigned (:mod:`daemon.live.acquisition.trigger_count`).
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from itertools import islice

from daemon.live.acquisition.pairing_events import (
    RECORDED_UNPAIRED,
    Event,
    FrameOutcome,
    Lost,
    PairingSettings,
    Resynced,
)
from daemon.live.acquisition.trigger_count import TriggerCount
from daemon.live.acquisition.waiting_frames import CameraHistory, WaitingFrame
from daemon.live.items import Pair
from drivers.protocols import SIDES, TRIGGER_MODULUS, Frame, Side

_HALF = TRIGGER_MODULUS // 2
_CONTRADICTION_WINDOW = 16


class Pairer:
    """Takes frames in the order of arrival; returns pairs and the outcomes of all other frames.

    ``feed`` and ``tick`` take the time of arrival on any monotonic clock; without one, the frame's own ``t_host_ns``
    is used.
    """

    def __init__(self, settings: PairingSettings | None = None) -> None:
        self.settings = settings or PairingSettings()
        self.outcomes: dict[Side, Counter[FrameOutcome]] = {side: Counter() for side in SIDES}
        self.received: Counter[Side] = Counter()
        self._cameras: dict[Side, CameraHistory] = {
            side: CameraHistory(
                history=deque(maxlen=self.settings.history), expired=deque(maxlen=self.settings.history)
            )
            for side in SIDES
        }
        self._count = TriggerCount()
        self._now_ns = 0
        self._synced = False
        self._confirmed = False
        self._observed_shift = 0
        self._observations = 0

    @property
    def shift(self) -> int:
        """Right trigger number minus left trigger number, as assumed now, modulo 2**32."""
        return (self._cameras["left"].shift - self._cameras["right"].shift) % TRIGGER_MODULUS

    @property
    def counter_restarts(self) -> int:
        """How often both counters restarted."""
        return self._count.counter_restarts

    @property
    def waiting(self) -> int:
        """Frames without an outcome yet."""
        return sum(len(camera.waiting) for camera in self._cameras.values())

    def feed(self, frame: Frame, now_ns: int | None = None) -> list[Event]:
        """Take one frame; returns the events that follow from it."""
        self.received[frame.side] += 1
        events = self.tick(frame.t_host_ns if now_ns is None else now_ns)
        rejected = self._rejection(frame)
        own = self._cameras[frame.side]
        entry = WaitingFrame(frame, (frame.trigger + own.shift) % TRIGGER_MODULUS, self._now_ns)
        if rejected is not None:
            return [*events, self._lost(entry, rejected)]
        self._mark_ambiguous(own, entry)
        own.history.append((frame.trigger, frame.t_exposure_ns))
        partner = self._partner(entry)
        if partner is not None and self._confirmed:
            return [*events, self._pair(entry, partner)]
        if self._is_late(entry):
            return [*events, self._lost(entry, FrameOutcome.LATE)]
        own.waiting.append(entry)
        events += self._compare(entry)
        if len(own.waiting) > self.settings.capacity:
            events.append(self._expire(own, own.waiting[0], FrameOutcome.ROOM_FULL))
        return events

    def tick(self, now_ns: int) -> list[Event]:
        """Expire frames that waited too long."""
        self._now_ns = max(self._now_ns, now_ns)
        oldest_ns = self._now_ns - self.settings.max_wait_ns
        return [
            self._expire(camera, entry, FrameOutcome.PARTNER_MISSING)
            for camera in self._cameras.values()
            for entry in [entry for entry in camera.waiting if entry.arrived_ns < oldest_ns]
        ]

    def camera_restarted(self, side: Side) -> None:
        """Unconfirm the shift: a camera was started again, so its count may have moved or restarted."""
        self._confirmed, self._observations = False, 0
        # Numbers from before the restart must not contradict those after it.
        self._cameras[side].history.clear()
        self._cameras[side].expired.clear()

    def flush(self) -> list[Event]:
        """End: every frame still waiting is counted as stopped."""
        remaining = [entry for camera in self._cameras.values() for entry in camera.waiting]
        for camera in self._cameras.values():
            camera.waiting.clear()
        return [self._lost(entry, FrameOutcome.STOPPED) for entry in remaining]

    def _rejection(self, frame: Frame) -> FrameOutcome | None:
        if frame.t_host_ns - frame.t_exposure_ns > self.settings.stale_ns:
            return FrameOutcome.STALE
        history = self._cameras[frame.side].history
        again = any(number == frame.trigger and self._same_time(t_ns, frame.t_exposure_ns) for number, t_ns in history)
        return FrameOutcome.DUPLICATE if again else None

    def _mark_ambiguous(self, camera: CameraHistory, entry: WaitingFrame) -> None:
        recent = islice(reversed(camera.history), _CONTRADICTION_WINDOW)
        entry.ambiguous = any(self._contradict(entry, number, t_ns) for number, t_ns in recent)
        for other in camera.waiting:
            other.ambiguous |= self._contradict(entry, other.frame.trigger, other.frame.t_exposure_ns)

    def _contradict(self, entry: WaitingFrame, number: int, t_ns: int) -> bool:
        return (number == entry.frame.trigger) != self._same_time(t_ns, entry.frame.t_exposure_ns)

    def _same_time(self, a_ns: int, b_ns: int) -> bool:
        return abs(a_ns - b_ns) <= self.settings.tolerance_ns

    def _opposite(self, side: Side) -> CameraHistory:
        return self._cameras["right" if side == "left" else "left"]

    def _partner(self, entry: WaitingFrame) -> WaitingFrame | None:
        for other in self._opposite(entry.frame.side).waiting:
            if other.ambiguous or entry.ambiguous:
                continue
            if other.number == entry.number and self._same_time(other.frame.t_exposure_ns, entry.frame.t_exposure_ns):
                return other
        return None

    def _is_late(self, entry: WaitingFrame) -> bool:
        expired = self._opposite(entry.frame.side).expired
        t_exposure_ns = entry.frame.t_exposure_ns
        return any(number == entry.number and self._same_time(t_ns, t_exposure_ns) for number, t_ns in expired)

    def _pair(self, entry: WaitingFrame, partner: WaitingFrame) -> Pair:
        self._opposite(entry.frame.side).waiting.remove(partner)
        self._synced, self._observations = True, 0
        self._continue_count(entry, partner)
        self._count.assigned(entry.number, entry.frame.t_exposure_ns, paired=True)
        frames: dict[Side, Frame] = {}
        for member in (entry, partner):
            side = member.frame.side
            self.outcomes[side][FrameOutcome.PAIRED] += 1
            self._cameras[side].last_paired = member.number
            frames[side] = member.numbered
        return Pair(frames["left"], frames["right"])

    def _continue_count(self, entry: WaitingFrame, partner: WaitingFrame) -> None:
        """After a restart of both counters: move all numbers behind those that were assigned."""
        waiting = [other.number for camera in self._cameras.values() for other in camera.waiting]
        move = self._count.move(entry.number, entry.frame.t_exposure_ns, waiting)
        if not move:
            return
        for camera in self._cameras.values():
            camera.move(move)
            camera.expired.clear()
        for member in (entry, partner):
            member.number = (member.number + move) % TRIGGER_MODULUS

    def _compare(self, entry: WaitingFrame) -> list[Event]:
        """Note which waiting frames agree; enough equal observations in a row confirm the shift."""
        together = []
        for other in self._opposite(entry.frame.side).waiting:
            number = other.number == entry.number
            time = self._same_time(other.frame.t_exposure_ns, entry.frame.t_exposure_ns)
            for member in (entry, other):
                member.agreed |= number and time
                member.same_number |= number and not time
                member.same_time |= time and not number
            together += [other] if time else []
        if len(together) != 1:
            return []
        left, right = (entry, together[0]) if entry.frame.side == "left" else (together[0], entry)
        return self._observe(left, right)

    def _observe(self, left: WaitingFrame, right: WaitingFrame) -> list[Event]:
        shift = (right.number - left.number) % TRIGGER_MODULUS
        self._observations = self._observations + 1 if shift == self._observed_shift else 1
        self._observed_shift = shift
        if shift:
            self._confirmed = False
        if self._observations < self.settings.resync_after:
            return []
        adopted = self._adopt_shift(left, right, shift) if shift else []
        self._confirmed = True
        return [*adopted, *self._pair_waiting()]

    def _adopt_shift(self, left: WaitingFrame, right: WaitingFrame, shift: int) -> list[Event]:
        """Adopt the new shift: move the numbers of the side that jumped."""
        only_left = self._fell_back("left", left) and not self._fell_back("right", right)
        jumped: Side = "left" if only_left else "right"
        camera = self._cameras[jumped]
        move = shift if jumped == "left" else -shift
        camera.move(move)
        camera.expired.clear()
        self._observations = self._observed_shift = 0
        return [Resynced(self.shift)]

    def _fell_back(self, side: Side, entry: WaitingFrame) -> bool:
        last = self._cameras[side].last_paired
        return last is not None and not 0 < (entry.number - last) % TRIGGER_MODULUS < _HALF

    def _pair_waiting(self) -> Iterator[Event]:
        for entry in list(self._cameras["left"].waiting):
            partner = self._partner(entry)
            if partner is not None:
                self._cameras["left"].waiting.remove(entry)
                yield self._pair(entry, partner)

    def _expire(self, camera: CameraHistory, entry: WaitingFrame, otherwise: FrameOutcome) -> Lost:
        camera.waiting.remove(entry)
        camera.expired.append((entry.number, entry.frame.t_exposure_ns))
        if entry.agreed:
            outcome = FrameOutcome.AMBIGUOUS if entry.ambiguous else FrameOutcome.BEFORE_SYNC
        elif entry.same_time:
            outcome = FrameOutcome.TRIGGER_MISMATCH
        elif entry.same_number:
            outcome = FrameOutcome.TIMESTAMP_MISMATCH
        else:
            outcome = otherwise if self._synced else FrameOutcome.BEFORE_SYNC
        return self._lost(entry, outcome)

    def _lost(self, entry: WaitingFrame, outcome: FrameOutcome) -> Lost:
        self.outcomes[entry.frame.side][outcome] += 1
        if outcome in RECORDED_UNPAIRED:
            self._count.assigned(entry.number, entry.frame.t_exposure_ns, paired=False)
        return Lost(entry.numbered, outcome)
