"""The pairer, shared by the camera threads; no consumer is called while its lock is held."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterable

from daemon.common.counters import Counters, Rate
from daemon.config.rig_config import Pairing
from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.pairing_events import RECORDED_UNPAIRED, Event, Lost, PairingSettings, Resynced
from daemon.live.items import Pair
from drivers.protocols import Clock, Frame, Side

log = logging.getLogger("fringed.pairing")

MAX_EVENTS = 32
"""Events that wait for a slow consumer; its camera's thread is the one that waits, the other goes on."""


def pairing_settings(config: Pairing) -> PairingSettings:
    """The limits as rig.yaml gives them."""
    return PairingSettings(
        tolerance_ns=round(1000 * config.tolerance_us),
        max_wait_ns=round(1e6 * config.max_wait_ms),
        resync_after=config.resync_after,
    )


class LockedPairer:
    """Takes frames from every camera's thread, and delivers pairs and unpaired frames in order, one at a time.

    Events are queued under the pairer's lock and delivered after its release, by whichever thread gets the second lock
    without waiting: a thread that finds it taken leaves its events to the thread that holds it.

    Args:
        paired: takes each pair; unpaired: takes frames whose partner is missing. Both must be quick.
        drops: counts events beyond :data:`MAX_EVENTS`.
    """

    def __init__(
        self,
        settings: PairingSettings,
        *,
        paired: Callable[[Pair], object],
        unpaired: Callable[[Frame], object],
        drops: Counters,
        clock: Clock,
    ) -> None:
        self._pairer, self._paired, self._unpaired = Pairer(settings), paired, unpaired
        self._drops, self._clock = drops, clock
        self._lock, self._delivering = threading.Lock(), threading.Lock()
        self._events: deque[Pair | Frame] = deque()
        self.pairs, self.rate = 0, Rate()

    @property
    def counter_restarts(self) -> int:
        """How often both cameras' counters restarted; takes no lock."""
        return self._pairer.counter_restarts

    def receive(self, frame: Frame) -> None:
        """Take a frame."""
        with self._lock:
            self._queue(self._pairer.feed(frame, self._clock.monotonic_ns()))
        self._deliver()

    def tick(self) -> None:
        """Expire frames that waited too long."""
        with self._lock:
            self._queue(self._pairer.tick(self._clock.monotonic_ns()))
        self._deliver()

    def camera_restarted(self, side: Side) -> None:
        """Unconfirm the shift of the counters after a camera was started again."""
        with self._lock:
            self._pairer.camera_restarted(side)

    def configure(self, settings: PairingSettings) -> None:
        """Use other limits from the next frame on."""
        with self._lock:
            self._pairer.settings = settings

    def flush(self) -> None:
        """End: give every frame its outcome and return when all events are delivered."""
        with self._lock:
            self._queue(self._pairer.flush())
        with self._delivering:
            self._drain()

    def outcomes(self, side: Side) -> dict[str, int]:
        """Counts of the outcomes of a camera's frames, and how many still wait."""
        with self._lock:
            counts = {str(outcome): count for outcome, count in sorted(self._pairer.outcomes[side].items())}
            waiting = self._pairer.received[side] - sum(counts.values())
            return counts | {"waiting": waiting}

    def _queue(self, events: Iterable[Event]) -> None:
        for event in events:
            if isinstance(event, Resynced):
                log.warning("the cameras' trigger counts differ: right minus left is now taken as %d", event.shift)
            elif isinstance(event, Lost) and event.outcome not in RECORDED_UNPAIRED:
                continue
            elif len(self._events) >= MAX_EVENTS:
                self._drops.add("frames_delivery_busy" if isinstance(event, Lost) else "pairs_delivery_busy")
            else:
                self._events.append(event.frame if isinstance(event, Lost) else event)

    def _deliver(self) -> None:
        # Checked again after the release: a thread that found the lock taken may have queued events meanwhile.
        while self._events and self._delivering.acquire(blocking=False):
            try:
                self._drain()
            finally:
                self._delivering.release()

    def _drain(self) -> None:
        while self._events:
            event = self._events.popleft()
            if isinstance(event, Pair):
                self.pairs += 1
                self.rate.note(self._clock.monotonic_ns())
                self._paired(event)
            else:
                self._unpaired(event)
