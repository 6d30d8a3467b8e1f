"""A disk that is too slow, or full: drops are counted, and what was written stays readable."""

from __future__ import annotations

import errno
import threading
from pathlib import Path
from typing import Any

import pytest

from daemon.common.errors import DaemonError
from daemon.recording.read.take_reader import TakeReader
from daemon.recording.write.part_writer import PartWriter
from tests.daemon.recording.takes import pair, pairs_of, writer
from tools.waiting import wait_until


class SlowPart(PartWriter):
    """A disk that waits for permission."""

    go = threading.Event()

    def write(self, *frames: Any) -> None:
        assert self.go.wait(60)
        super().write(*frames)


def test_a_slow_disk_drops_and_counts(tmp_path: Path) -> None:
    SlowPart.go.clear()
    recorder = writer(tmp_path / "take.mcap", queue=2, open_part=SlowPart)
    assert recorder.offer(pair(0))
    wait_until(lambda: recorder.status()["queued"] == 0)
    assert [recorder.offer(pair(n)) for n in range(1, 6)] == [True, True, False, False, False]
    assert recorder.status()["dropped"] == {"queue_full": 3}
    SlowPart.go.set()
    recorder.close()
    assert not recorder.offer(pair(9))
    assert recorder.status()["dropped"] == {"queue_full": 3, "closed": 1}
    assert [p.sequence for p in pairs_of(tmp_path / "take.mcap")] == [0, 1, 2]


class FullPart(PartWriter):
    """A disk that is full after two pairs; ``ends``: whether there is room for the index."""

    ends = True

    def write(self, *frames: Any) -> None:
        if frames[0].trigger == 2:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().write(*frames)

    def finish(self) -> None:
        if not self.ends:
            raise OSError(errno.ENOSPC, "No space left on device")
        super().finish()


@pytest.mark.parametrize(("ends", "name"), [(True, "take.mcap"), (False, "take.mcap.partial")])
def test_a_full_disk_is_reported_and_what_was_written_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ends: bool, name: str
) -> None:
    monkeypatch.setattr(FullPart, "ends", ends)
    recorder = writer(tmp_path / "take.mcap", open_part=FullPart)
    for number in range(2):
        assert recorder.offer(pair(number))
    wait_until(lambda: recorder.status()["pairs"] == 2)
    assert recorder.offer(pair(2))
    wait_until(lambda: "problem" in recorder.status())
    assert not recorder.offer(pair(3))
    recorder.close()
    recorder.close()
    status = recorder.status()
    assert "No space left" in status["problem"]
    assert status["dropped"] == {"failed": 2}
    assert status["files"] == [str(tmp_path / name)]
    with TakeReader(tmp_path / name) as take:
        assert [p.sequence for p in take.pairs()] == [0, 1]
        assert take.whole == ends


def test_the_guard_ends_the_take_while_it_can_still_be_finished(tmp_path: Path) -> None:
    free = [5 << 30]
    recorder = writer(tmp_path / "take.mcap", min_free_bytes=1 << 30, free_bytes=lambda _: free[0])
    assert recorder.offer(pair(0))
    wait_until(lambda: recorder.status()["pairs"] == 1)
    free[0] = 1 << 30
    recorder.offer(pair(1))
    wait_until(lambda: "problem" in recorder.status())
    recorder.close()
    status = recorder.status()
    assert "1074 MB free" in status["problem"]
    assert "recording.min_free_mb" in status["problem"]
    assert status["dropped"] == {"failed": 1}
    assert [p.sequence for p in pairs_of(tmp_path / "take.mcap")] == [0]
    with pytest.raises(DaemonError, match="MB free"):
        writer(tmp_path / "next.mcap", min_free_bytes=2 << 30, free_bytes=lambda _: free[0])
