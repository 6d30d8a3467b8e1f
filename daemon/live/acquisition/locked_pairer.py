"""The pairing, shared by the camera threads: each event goes where it belongs, under one lock."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable

from daemon.common.counters import Rate
from daemon.config.rig_config import Pairing
from daemon.live.acquisition.pairer import RECORDED_UNPAIRED, Event, Lost, Pair, Pairer, PairingSettings, Resynced
from drivers.protocols import Clock, Frame, Side

log = logging.getLogger("fringed.pairing")


def pairing_settings(config: Pairing) -> PairingSettings:
    """The limits as rig.yaml gives them."""
    return PairingSettings(
        tolerance_ns=round(1000 * config.tolerance_us),
        max_wait_ns=round(1e6 * config.max_wait_ms),
        resync_after=config.resync_after,
    )


class LockedPairer:
    """Takes frames from every camera's thread.

    Args:
        paired: takes each pair; lone: takes frames whose partner is missing. Both must be quick.
    """

    def __init__(
        self,
        settings: PairingSettings,
        *,
        paired: Callable[[Pair], None],
        lone: Callable[[Frame], None],
        clock: Clock,
    ) -> None:
        self._pairer, self._paired, self._lone, self._clock = Pairer(settings), paired, lone, clock
        self._lock = threading.Lock()
        self.pairs, self.rate = 0, Rate()

    @property
    def counter_restarts(self) -> int:
        """How often both cameras began to count anew; takes no lock."""
        return self._pairer.counter_restarts

    def receive(self, frame: Frame) -> None:
        """Take a frame."""
        with self._lock:
            self._handle(self._pairer.feed(frame, self._clock.monotonic_ns()))

    def tick(self) -> None:
        """Let time pass."""
        with self._lock:
            self._handle(self._pairer.tick(self._clock.monotonic_ns()))

    def camera_restarted(self, side: Side) -> None:
        """A camera was started anew."""
        with self._lock:
            self._pairer.camera_restarted(side)

    def limit(self, settings: PairingSettings) -> None:
        """Other limits from the next frame on."""
        with self._lock:
            self._pairer.settings = settings

    def flush(self) -> None:
        """The end: every frame meets its fate."""
        with self._lock:
            self._handle(self._pairer.flush())

    def outcomes(self, side: Side) -> dict[str, int]:
        """Counts of what became of a camera's frames, and how many still wait."""
        with self._lock:
            counts = {str(outcome): count for outcome, count in sorted(self._pairer.outcomes[side].items())}
            waiting = self._pairer.fed[side] - sum(counts.values())
            return counts | {"waiting": waiting}

    def _handle(self, events: list[Event]) -> None:
        for event in events:
            if isinstance(event, Pair):
                self.pairs += 1
                self.rate.note(self._clock.monotonic_ns())
                self._paired(event)
            elif isinstance(event, Lost):
                if event.outcome in RECORDED_UNPAIRED:
                    self._lone(event.frame)
            elif isinstance(event, Resynced):
                log.warning("the cameras' trigger counts differ: right minus left is now taken as %d", event.shift)
