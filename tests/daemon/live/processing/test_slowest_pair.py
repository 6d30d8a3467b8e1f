"""The slowest recent pair, and where its time went."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daemon.live.items import CloudItem
from daemon.live.processing.slowest_pair import SlowestPair
from drivers.protocols import Frame, Side
from tests.daemon.live.processing.test_worker import CLOUD

MS, MINUTE_NS, T_NS = 1_000_000, 60_000_000_000, 1_700_000_000_000_000_000


def cloud(seq: int, latency_ms: float, *, arrival_ms: int = 5) -> CloudItem:
    """A cloud whose right frame arrived one millisecond after the left one."""

    def frame(side: Side, late_ms: int) -> Frame:
        return Frame(side, seq, T_NS, T_NS + late_ms * MS, "mono8", np.zeros((4, 6), np.uint8))

    made = replace(CLOUD, ms={"decode": 2.0, "orders": 3.0})
    return CloudItem(seq, T_NS, made, frame("left", arrival_ms - 1), frame("right", arrival_ms), latency_ms)


def test_the_parts_of_the_longest_latency_add_up() -> None:
    slowest = SlowestPair()
    assert slowest.summary() == {}
    for seq, latency_ms in enumerate((20.0, 90.0, 30.0)):
        slowest.note(cloud(seq, latency_ms), T_NS + 12 * MS, seq)
    found = slowest.summary()
    assert found["seq"] == 1 and found["latency_ms"] == 90.0 and found["stages_ms"] == {"decode": 2.0, "orders": 3.0}
    assert (found["arrival_ms"], found["waiting_ms"], found["measuring_ms"]) == (5.0, 7.0, 78.0)


@pytest.mark.parametrize(("minutes", "seq"), [(4, 0), (6, 0), (9, 0), (11, 1)])
def test_a_slow_pair_is_kept_for_five_to_ten_minutes(minutes: int, seq: int) -> None:
    slowest = SlowestPair()
    start_ns = 77 * MINUTE_NS
    slowest.note(cloud(0, 90.0), T_NS, start_ns)
    for half in range(1, 2 * minutes + 1):
        slowest.note(cloud(1, 20.0), T_NS, start_ns + half * MINUTE_NS // 2)
    assert slowest.summary()["seq"] == seq
