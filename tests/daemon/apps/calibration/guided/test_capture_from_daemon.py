"""What a daemon may answer, and what becomes of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.apps.calibration.guided.capture_from_daemon import DaemonShooter
from daemon.common.errors import ControlError, DaemonError
from daemon.live.items import PairItem
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame, Side
from pipeline.pattern.sequence import camera_sequence

SEQUENCE = camera_sequence((64, 48))
IDLE = {"state": "idle", "job": 0, "done": 0, "of": 0, "outcome": "", "file": None, "problem": None}


class Daemon:
    """Answers ``calibrate.status`` from a list; the first answer is for the greeting."""

    endpoint = "ipc://nowhere"

    def __init__(self, *answers: dict[str, Any]) -> None:
        self.answers = [IDLE | {"projector": [64, 48], "hand": False}, *(IDLE | answer for answer in answers)]
        self.called: list[str] = []

    def call(self, method: str, /, **params: Any) -> Any:
        self.called.append(method)
        if method == "calibrate.status":
            return self.answers.pop(0) if len(self.answers) > 1 else self.answers[0]
        if method == "calibrate.capture":
            assert params["frames"] == [frame.as_mapping() for frame in SEQUENCE.frames]
            return {"job": 7}
        if method == "calibrate.next_pose":
            raise ControlError("no hand")
        return {}

    def close(self) -> None:
        self.called.append("close")


def shooter(*answers: dict[str, Any], **options: Any) -> tuple[DaemonShooter, Daemon]:
    daemon = Daemon(*answers)
    return DaemonShooter(daemon, **options), daemon  # type: ignore[arg-type]


def test_a_daemon_that_is_still_starting_is_told() -> None:
    daemon = Daemon()
    daemon.answers = [IDLE | {"projector": None}]
    with pytest.raises(DaemonError, match="still starting"):
        DaemonShooter(daemon)  # type: ignore[arg-type]


def test_a_failed_capture_gives_the_daemons_words() -> None:
    made, _ = shooter({"job": 7, "of": 1}, {"job": 7, "of": 1, "outcome": "failed", "problem": "the cable is out"})
    with pytest.raises(DaemonError, match="the cable is out"):
        made.shoot(SEQUENCE)


def test_somebody_elses_capture_is_noticed() -> None:
    made, _ = shooter({"job": 8, "of": 1})
    with pytest.raises(DaemonError, match="somebody else captures"):
        made.shoot(SEQUENCE)


def test_stopping_cancels_the_capture_in_the_daemon() -> None:
    made, daemon = shooter({"job": 7, "of": 9}, cancelled=lambda: True)
    with pytest.raises(CaptureCancelledError):
        made.shoot(SEQUENCE)
    assert daemon.called[-1] == "calibrate.cancel"


def test_a_capture_that_was_cancelled_in_the_daemon_is_no_failure_of_the_devices() -> None:
    made, _ = shooter({"job": 7, "of": 1, "outcome": "cancelled"})
    with pytest.raises(CaptureCancelledError):
        made.shoot(SEQUENCE)


def test_a_file_with_fewer_images_than_asked_for_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = TakeWriter(
        path, session="s", device="d", calibration_data=b"", pattern=SEQUENCE.as_mapping(), volume={}, min_free_bytes=0
    )
    sides: tuple[Side, Side] = ("left", "right")
    frames = [Frame(side, 3, 5, 6, "mono8", np.zeros((4, 4), np.uint8)) for side in sides]
    writer.offer(PairItem(*frames))
    writer.close()
    made, _ = shooter({"job": 7, "of": 1, "outcome": "done", "file": str(path)})
    with pytest.raises(DaemonError, match="1 of 1 images are there, numbered from 3"):
        made.shoot(SEQUENCE)


def test_without_a_hand_nothing_is_moved_and_the_end_lets_the_daemon_measure() -> None:
    made, daemon = shooter()
    with made:
        assert not made.has_hand and not made.next_pose()
    assert daemon.called == ["calibrate.status", "calibrate.cancel", "close"]
