"""Takes that begin before they were asked for, and the switch that starts and ends them."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from daemon.cli.control.status_rows import recorder_text
from daemon.common.errors import ConfigError, DaemonError
from daemon.config import RigConfig, parse_rig
from daemon.live.items import CloudItem
from daemon.recording.format.errors import TakeError
from daemon.recording.read.take_reader import TakeReader
from daemon.recording.recorder import Recorder
from daemon.recording.write.pretrigger_buffer import PretriggerBuffer, size_of
from daemon.recording.write.take_writer import TakeWriter
from tests.daemon.recording.takes import pair, unpaired, writer
from tools.waiting import wait_until

RATE_HZ = 20


class Rig:
    """Router and clock for the recorder; time is the test's."""

    def __init__(self, recording: str = "") -> None:
        self.config: RigConfig = parse_rig(f"cameras: {{driver: sim}}\nrecording: {{{recording}}}\n")
        self.clock = SimpleNamespace(realtime_ns=lambda: 1_790_000_000_000_000_000, monotonic_ns=lambda: self.now_ns)
        self.now_ns = 0
        self.sinks: dict[str, Any] = {}

    def add_sink(self, name: str, sink: Any) -> None:
        self.sinks[name] = sink

    def measures(self, recorder: Recorder, first: int, count: int) -> None:
        for number in range(first, first + count):
            self.now_ns += 10**9 // RATE_HZ
            assert recorder.offer(pair(number))


def recorder_of(rig: Rig, directory: Path, open_take: Callable[[Path], Any] | None = None) -> Recorder:
    make = open_take or (lambda path: writer(path, queue=4))
    return Recorder(rig, rig.config, directory, make, clock=rig.clock)  # type: ignore[arg-type]


def numbers(path: str) -> list[int]:
    with TakeReader(Path(path)) as take:
        return [one.sequence for one in take.pairs()]


def test_a_take_begins_before_it_was_asked_for_without_gap_or_doubling(tmp_path: Path) -> None:
    rig = Rig("before_s: 4")
    recorder = recorder_of(rig, tmp_path / "takes", lambda path: writer(path, queue=1000))
    rig.measures(recorder, 0, 200)
    answer = recorder.start("a", before_s=1.99)
    assert answer["before_items"] == 40
    rig.measures(recorder, 200, 20)
    assert recorder.stop()["pairs"] == 60
    assert numbers(answer["file"]) == list(range(160, 220))


def test_what_was_kept_need_not_fit_into_the_queue(tmp_path: Path) -> None:
    rig = Rig("before_s: 10")
    recorder = recorder_of(rig, tmp_path)
    rig.measures(recorder, 0, 100)
    file = recorder.start("a", before_s=10.0)["file"]
    assert recorder.stop()["dropped"] == {}
    assert numbers(file) == list(range(100))


def test_nothing_is_kept_unless_it_is_configured(tmp_path: Path) -> None:
    rig = Rig()
    recorder = recorder_of(rig, tmp_path)
    rig.measures(recorder, 0, 30)
    assert recorder.status() == {"recording": False}
    with pytest.raises(DaemonError, match=r"keeps 0 s; raise recording\.before_s"):
        recorder.start("a", before_s=5.0)
    assert list(tmp_path.iterdir()) == [] and not recorder.recording


def test_the_limits_that_hold_now_are_the_configured_ones(tmp_path: Path) -> None:
    rig = Rig("before_s: 4")
    recorder = recorder_of(rig, tmp_path)
    rig.measures(recorder, 0, 100)
    assert recorder.status()["before"]["items"] > 60
    recorder.change(Rig().config, None)()  # type: ignore[arg-type]
    rig.measures(recorder, 100, 1)
    assert recorder.status() == {"recording": False}


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.tuples(st.integers(0, 2_000_000_000), st.booleans()), max_size=60),
    st.floats(0.1, 5),
    st.integers(1, 60_000),
)
def test_the_ring_never_holds_more_than_its_seconds_and_bytes(
    steps: list[tuple[int, bool]], seconds: float, most: int
) -> None:
    now, offered = [0], []
    ring = PretriggerBuffer(lambda: (seconds, most), lambda: now[0])
    for number, (step_ns, alone) in enumerate(steps):
        now[0] += step_ns
        item = unpaired("left", number) if alone else pair(number)
        offered.append((now[0], item))
        ring.add(item)
        status = ring.status()
        assert status["bytes"] <= most and status["kept_s"] <= seconds + 0.01
        kept = ring.last(seconds)
        assert status["items"] == len(kept)
        assert [id(one) for one in kept] == [id(one) for _, one in offered[len(offered) - len(kept) :]]
        assert sum(map(size_of, kept)) == status["bytes"]


def test_clouds_pass_by(tmp_path: Path) -> None:
    rig = Rig("before_s: 1")
    recorder = recorder_of(rig, tmp_path)
    item, cloud = pair(0), None
    assert recorder.offer(CloudItem(0, 0, cloud, item.left, item.right, 0.0))  # type: ignore[arg-type]
    assert recorder.status()["before"]["items"] == 0


def test_one_take_at_a_time_and_closing_ends_it(tmp_path: Path) -> None:
    rig = Rig()
    recorder = recorder_of(rig, tmp_path)
    assert rig.sinks == {"recorder": recorder}
    file = recorder.start("a")["file"]
    with pytest.raises(DaemonError, match="already"):
        recorder.start("b")
    rig.measures(recorder, 0, 3)
    recorder.close()
    assert recorder.stop() == {"recording": False}
    assert numbers(file) == [0, 1, 2]


def test_a_directory_that_cannot_be_written_is_named_and_the_next_try_may_succeed(tmp_path: Path) -> None:
    rig, blocked = Rig(), tmp_path / "file"
    blocked.write_text("no directory")
    recorder = recorder_of(rig, blocked / "takes")
    with pytest.raises(DaemonError, match=rf"{blocked}/takes: cannot be created: Not a directory; set recording\.dir"):
        recorder.start("a")
    blocked.unlink()
    assert recorder.start("a")["recording"]
    recorder.close()


def test_a_read_only_directory_is_named(tmp_path: Path) -> None:
    def refused(path: Path) -> TakeWriter:
        raise PermissionError(13, "Permission denied", str(path))

    recorder = recorder_of(Rig(), tmp_path, refused)
    with pytest.raises(DaemonError, match=rf"{tmp_path}/a_.*cannot be written: Permission denied; correct"):
        recorder.start("a")
    assert not recorder.recording


def test_the_takes_of_the_directory_are_listed(tmp_path: Path) -> None:
    rig = Rig()
    recorder = recorder_of(rig, tmp_path / "takes")
    assert recorder.takes()["takes"] == []
    recorder.start("a")
    rig.measures(recorder, 0, 3)
    (running,) = recorder.takes()["takes"]
    assert running["state"] == "writing"
    recorder.stop()
    (tmp_path / "takes" / "x.mcap").write_bytes(os.urandom(100))
    report = recorder.takes()
    assert [(take["state"], take["frames"]) for take in report["takes"]] == [("whole", [3, 3])]
    assert list(report["garbage"]) == ["x.mcap"]


def test_the_status_has_a_line_for_it(tmp_path: Path) -> None:
    rig = Rig("before_s: 1")
    recorder = recorder_of(rig, tmp_path)
    rig.measures(recorder, 0, 10)
    assert recorder_text(recorder.status()) == "off, 0.5 s kept before a start"
    recorder.start("a")
    rig.measures(recorder, 10, 3)
    wait_until(lambda: recorder.status()["pairs"] == 3)
    assert re.match(r"a_\S+\.mcap, 3 pairs, 0\.\d MB in 1 file\(s\), safe up to", recorder_text(recorder.status()))
    recorder.close()


def test_keeping_little_needs_the_word_endless() -> None:
    with pytest.raises(ConfigError, match=r"rig\.yaml:2:\d+.*keep_mb.*recording\.endless: true|endless: true"):
        parse_rig("cameras: {driver: sim}\nrecording: {keep_mb: 100}\n")
    assert parse_rig("cameras: {driver: sim}\nrecording: {keep_mb: 100, endless: true}\n").recording.keep_mb == 100


def test_a_take_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(TakeError, match="No such file"):
        TakeReader(tmp_path / "none.mcap")
