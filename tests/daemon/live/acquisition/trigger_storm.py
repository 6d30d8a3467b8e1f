"""A little generator of two cameras' frames with every fault, and the truth of which exposure each frame shows."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from drivers.protocols import SIDES, TRIGGER_MODULUS, Frame, Side

PERIOD_NS = 33_000_000
_IMAGE = np.zeros((1, 1), np.uint8)


@dataclass(frozen=True)
class Faults:
    """Chance of each fault per frame (or per trigger), and when the long ones happen."""

    lost: float = 0.01
    late: float = 0.01
    duplicate: float = 0.01
    wrong_number: float = 0.01
    wrong_time: float = 0.005
    blackout: float = 0.001
    gone: float = 0.0007
    extra_first: tuple[Side, ...] = ()
    start: int = 0
    jitter_ns: int = 300_000


@dataclass(frozen=True)
class Sent:
    frame: Frame
    exposure: int


def storm(triggers: int, faults: Faults, seed: int = 0) -> list[Sent]:
    """All frames in the order of arrival; ``exposure`` is the true index of the exposure, -1 for an extra frame."""
    rng = np.random.default_rng(seed)
    sent = [item for side in SIDES for item in _camera(side, triggers, faults, rng)]
    return sorted(sent, key=lambda item: item.frame.t_host_ns)


def _camera(side: Side, triggers: int, faults: Faults, rng: np.random.Generator) -> Iterator[Sent]:
    counter, away_until = faults.start, 0
    if side in faults.extra_first:
        yield Sent(_frame(side, counter, -PERIOD_NS * 3 // 2, 8_000_000), -1)
        counter += 1
    dark_until = 0
    shared = np.random.default_rng(99)
    for k in range(triggers):
        if shared.random() < faults.blackout:
            dark_until = k + 40
        if rng.random() < faults.gone:
            away_until, counter = k + int(rng.integers(3, 90)), 0
        if k < away_until:
            continue
        number, counter = counter, counter + 1
        if k < dark_until or rng.random() < faults.lost:
            continue
        yield from _deliver(side, k, number, faults, rng)


def _deliver(side: Side, k: int, number: int, faults: Faults, rng: np.random.Generator) -> Iterator[Sent]:
    t_ns = k * PERIOD_NS + int(rng.integers(-faults.jitter_ns, faults.jitter_ns + 1))
    delay_ns = 8_000_000 + int(rng.integers(0, 3_000_000))
    if rng.random() < faults.late:
        delay_ns += int(rng.integers(1, 40)) * PERIOD_NS
    if rng.random() < faults.wrong_number:
        number += int(rng.choice([-2, -1, 1, 2, 1000, -100000]))
    elif rng.random() < faults.wrong_time:  # never both: two lies that agree are one truth
        t_ns += int(rng.choice([-1, 1, 2])) * PERIOD_NS
    frame = _frame(side, number, t_ns, delay_ns)
    yield Sent(frame, k)
    if rng.random() < faults.duplicate:
        yield Sent(replace(frame, t_host_ns=frame.t_host_ns + int(rng.integers(1, 50_000_000))), k)


def _frame(side: Side, number: int, t_ns: int, delay_ns: int) -> Frame:
    t_ns += 1_000_000_000_000
    return Frame(side, number % TRIGGER_MODULUS, t_ns, t_ns + delay_ns, "mono8", _IMAGE)
