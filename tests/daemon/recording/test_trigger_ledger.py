"""A take never makes a pair of two exposures, whatever the cameras' counts do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.common.clock import SystemClock
from daemon.common.counters import Counters
from daemon.live.acquisition.locked_pairer import LockedPairer
from daemon.live.acquisition.pairing_events import FrameOutcome, PairingSettings
from daemon.live.items import Item, Pair, UnpairedFrame
from daemon.recording.read.take_reader import TakeReader
from drivers.protocols import Frame, Side
from tests.daemon.live.acquisition.trigger_storm import PERIOD_NS, Faults, Sent, _frame, storm
from tests.daemon.recording.takes import frame, pair, unpaired, write, writer

_SIDES: tuple[Side, Side] = ("left", "right")


class Arrivals(SystemClock):
    """Time is that of the frame that comes."""

    now_ns = 0

    def monotonic_ns(self) -> int:
        return self.now_ns


def played(sent: list[Sent], restarts: dict[int, tuple[Side, ...]] | None = None) -> tuple[list[Item], LockedPairer]:
    """What a recorder is offered when these frames come; restarts: cameras restarted before an exposure."""
    items: list[Item] = []
    clock = Arrivals()
    pairer = LockedPairer(
        PairingSettings(),
        paired=items.append,
        unpaired=lambda frame: items.append(UnpairedFrame(frame)),
        drops=Counters(),
        clock=clock,
    )
    due = dict(restarts or {})
    for item in sent:
        clock.now_ns = max(clock.now_ns, item.frame.t_host_ns)
        for side in due.pop(item.exposure, ()):
            pairer.camera_restarted(side)
        pairer.receive(item.frame)
    clock.now_ns += 10**12
    pairer.tick()
    return items, pairer


def imaged(sent: list[Sent]) -> list[Sent]:
    """The same frames, each image encoding its exposure."""
    out = []
    for item in sent:
        image = np.full((1, 8), item.exposure % 251, np.uint8)
        f = item.frame
        out.append(Sent(Frame(f.side, f.trigger, f.t_exposure_ns, f.t_host_ns, "mono8", image), item.exposure))
    return out


def pairs_read(path: Path, items: list[Item]) -> tuple[list[tuple[int, int]], dict[str, int]]:
    """Exposure of the left and of the right image of every pair that a reader makes of the take."""
    status = write(path, items)
    with TakeReader(path) as take:
        return [(int(p.left[0, 0]), int(p.right[0, 0])) for p in take.pairs()], status["dropped"]


def test_restarted_counters_make_no_wrong_pair_and_the_numbers_continue(tmp_path: Path) -> None:
    """Both cameras counted to 40, the right one lost frames; then both begin at zero, and the left one loses some."""
    sent = [
        Sent(_frame(side, k if k < 40 else k - 40, k * PERIOD_NS, 1), k)
        for k in range(80)
        for side in _SIDES
        if not (side == "right" and k in (5, 9)) and not (side == "left" and k in (45, 49))
    ]
    items, _ = played(imaged(sent), {40: _SIDES})
    pairs, _ = pairs_read(tmp_path / "take.mcap", items)
    assert [left for left, right in pairs] == [right for left, right in pairs]
    assert len(pairs) == 76
    numbers = [item.left.trigger for item in items if isinstance(item, Pair)]
    assert numbers == sorted(set(numbers))


def test_an_unpaired_frame_carries_the_common_count(tmp_path: Path) -> None:
    """The right camera counted one frame more; where the left one lost a frame, it stands under the left number."""
    sent = [Sent(_frame("right", 0, -PERIOD_NS * 3 // 2, 1), 250)]
    sent += [
        Sent(_frame(side, k + (side == "right"), k * PERIOD_NS, 1), k)
        for k in range(30)
        for side in _SIDES
        if (side, k) != ("left", 12)
    ]
    items, _ = played(imaged(sent))
    alone = [item.frame.trigger for item in items if isinstance(item, UnpairedFrame)]
    assert 12 in alone
    pairs, dropped = pairs_read(tmp_path / "take.mcap", items)
    assert pairs == [(k, k) for k in range(30) if k != 12]
    assert dropped == {}


@pytest.mark.parametrize("early", _SIDES)
def test_a_camera_that_came_first_costs_no_pair(tmp_path: Path, early: Side) -> None:
    late: Side = "right" if early == "left" else "left"
    sent = [Sent(_frame(early, k, k * PERIOD_NS, 1), k) for k in range(60)]
    sent += [Sent(_frame(late, k - 30, k * PERIOD_NS, 1), k) for k in range(30, 60)]
    sent.sort(key=lambda item: item.frame.t_host_ns)
    items, _ = played(imaged(sent), {30: (late,)})
    pairs, dropped = pairs_read(tmp_path / "take.mcap", items)
    assert pairs == [(k, k) for k in range(30, 60)]
    assert dropped == {}


@pytest.mark.parametrize("seed", range(6))
def test_no_storm_of_faults_makes_a_wrong_pair_in_a_take(tmp_path: Path, seed: int) -> None:
    faults = Faults(lost=0.05, late=0.05, wrong_number=0.03, gone=0.005, extra_first=("right",))
    sent = imaged(storm(800, faults, seed))
    items, pairer = played(sent)
    path = tmp_path / "take.mcap"
    status = write(path, items, max_part_bytes=40_000)
    assert len(status["files"]) > 1
    with TakeReader(path) as take:
        read = [(int(p.left[0, 0]), int(p.right[0, 0])) for p in take.pairs()]
    assert read and all(left == right for left, right in read)
    paired = pairer.outcomes("left")[FrameOutcome.PAIRED]
    assert len(read) >= 0.8 * paired


def test_a_number_with_another_exposure_is_not_written(tmp_path: Path) -> None:
    first, second = frame("left", 7), frame("right", 7)
    moved = Frame("right", 7, second.t_exposure_ns + 33_000_000, second.t_host_ns, "rgb8", second.image)
    path = tmp_path / "take.mcap"
    status = write(path, [UnpairedFrame(first), UnpairedFrame(moved), pair(8)])
    assert status["dropped"] == {"number_in_doubt": 1}
    with TakeReader(path) as take:
        assert [p.sequence for p in take.pairs()] == [8]


def test_halves_of_a_pair_are_not_spread_over_two_parts(tmp_path: Path) -> None:
    path = tmp_path / "take.mcap"
    status = write(path, [unpaired("left", 0), pair(1), pair(2), pair(3), unpaired("right", 0)], max_part_bytes=12_000)
    assert len(status["files"]) > 1
    assert status["dropped"] == {"partner_in_earlier_part": 1}


def test_more_numbers_than_are_remembered_cost_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("daemon.recording.write.trigger_ledger._SLOTS", 8)
    path = tmp_path / "take.mcap"
    recorder = writer(path)
    for number in (*range(4_294_967_290, 4_294_967_296), *range(20)):
        assert recorder.offer(pair(number))
    recorder.close()
    assert recorder.status()["pairs"] == 26
