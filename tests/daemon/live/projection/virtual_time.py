"""A projector with a latency and two triggered cameras in virtual time, which passes only while a caller waits."""

from __future__ import annotations

import random
from typing import Any

import numpy as np

from daemon.common.counters import Counters
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.live.acquisition.locked_pairer import LockedPairer
from daemon.live.acquisition.pairing_events import PairingSettings
from daemon.live.items import Pair
from drivers.protocols import SIDES, Flip, Frame, ProjectorInfo, Side

NOW_NS = 1_700_000_000_000_000_000
MIXED = 255
MS = 1_000_000


class Bench:
    """Time, light, triggers and pairing.

    Each camera's image holds the level of the light during its exposure, or MIXED if that changed meanwhile.

    Args:
        latency_ms: from flip to light; reported_ms: that the projector reports, None = none.
        period_ms, exposure_ms: of the triggers. seed: of everything that varies.
        lost: share of frames that never arrive; late_ms: how long they may take to arrive.
        jitter_us: how far the times of the exposures are off.
    """

    def __init__(
        self,
        *,
        latency_ms: float = 20.0,
        reported_ms: float | None = 20.0,
        period_ms: float = 33.0,
        exposure_ms: float = 8.0,
        show_ms: float = 10.0,
        lost: float = 0.0,
        late_ms: float = 0.0,
        jitter_us: float = 0.0,
        seed: int = 0,
    ) -> None:
        self.now_ns, self.latency_ns = NOW_NS, round(MS * latency_ms)
        self.latency_s = None if reported_ms is None else reported_ms / 1e3
        self.period_ns, self.exposure_ns = round(MS * period_ms), round(MS * exposure_ms)
        self.show_ms, self.lost, self.late_ms, self.jitter_us = show_ms, lost, late_ms, jitter_us
        self.random = random.Random(seed)
        self.changes: list[tuple[int, int]] = [(0, 0)]
        self.triggers = 0
        self.first_ns = NOW_NS + self.random.randrange(self.period_ns)
        self.due: list[tuple[int, Frame]] = []
        self.box: LatestWinsQueue[Pair] = LatestWinsQueue(4)
        settings = PairingSettings(tolerance_ns=2 * MS, max_wait_ns=500 * MS)
        self.pairer = LockedPairer(settings, paired=self.box.put, unpaired=lambda _: None, drops=Counters(), clock=self)
        self.counted = {"restarts": 0}
        self.trouble = ""
        self.shown = 0
        self.fixed_image = False

    # Clock
    def realtime_ns(self) -> int:
        return self.now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns - NOW_NS

    # Projector
    def open(self) -> ProjectorInfo:
        return ProjectorInfo("bench", (4, 2), 60.0, self.latency_s, self.fixed_image)

    def show(self, image: Any) -> Flip:
        self.shown += 1
        flip_ns = self.now_ns + round(MS * self.random.uniform(0, self.show_ms))
        self.changes.append((flip_ns + self.latency_ns, int(image[0, 0, 0])))
        self.pass_until(flip_ns + round(MS * self.random.uniform(0, self.show_ms)))
        return Flip(flip_ns - NOW_NS, flip_ns, 0, "present")

    def problem(self) -> str:
        return self.trouble

    def close(self) -> None:
        pass

    # Pairs
    def get(self, timeout_s: float) -> Pair | None:
        end_ns = self.now_ns + round(1e9 * timeout_s)
        while self.now_ns < end_ns and not len(self.box):
            self.pass_until(min(end_ns, self.now_ns + MS))
        return self.box.get(0.0)

    def light(self, start_ns: int, end_ns: int) -> int:
        before = [level for since, level in self.changes if since <= start_ns][-1]
        during = {level for since, level in self.changes if start_ns < since < end_ns}
        return MIXED if during - {before} else before

    def pass_until(self, t_ns: int) -> None:
        while self.first_ns + self.triggers * self.period_ns <= t_ns:
            self.trigger(self.triggers, self.first_ns + self.triggers * self.period_ns)
            self.triggers += 1
        # A frame shows the light until the end of its exposure, so it is made when that is known.
        for due_ns, frame in sorted((item for item in self.due if item[0] <= t_ns), key=lambda item: item[0]):
            self.now_ns = max(self.now_ns, due_ns)
            start_ns = self.first_ns + frame.trigger * self.period_ns
            frame.image[:] = self.light(start_ns, start_ns + self.exposure_ns)
            self.pairer.receive(frame)
        self.due = [item for item in self.due if item[0] > t_ns]
        self.now_ns = max(self.now_ns, t_ns)
        self.pairer.tick()

    def trigger(self, number: int, t_ns: int) -> None:
        late_ns = round(MS * self.random.uniform(0, self.late_ms))
        for side in SIDES:
            self.expose(number, t_ns, side, late_ns)

    def expose(self, number: int, t_ns: int, side: Side, late_ns: int) -> None:
        if self.random.random() < self.lost:
            return
        reported_ns = t_ns + round(1e3 * self.random.uniform(-self.jitter_us, self.jitter_us))
        here_ns = t_ns + self.exposure_ns + 2 * MS + late_ns
        frame = Frame(side, number, reported_ns, here_ns, "mono8", np.zeros((4, 6), np.uint8))
        self.due.append((here_ns, frame))


def image(level: int) -> Any:
    return np.full((2, 4, 3), level, np.uint8)


def level(pair: Pair) -> set[int]:
    return {int(value) for frame in (pair.left, pair.right) for value in np.unique(frame.image)}
