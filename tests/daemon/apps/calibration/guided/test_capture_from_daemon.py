"""The daemon's answers to a capture, and their effects."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.apps.calibration.guided.capture_from_daemon import CaptureFromDaemon
from daemon.common.errors import DaemonError
from daemon.live.items import Pair
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame, Side
from fringed.errors import ControlError
from pipeline.pattern.sequence import camera_sequence

SEQUENCE = camera_sequence((64, 48))
IDLE = {"state": "idle", "job": 0, "done": 0, "of": 0, "outcome": "", "file": None, "problem": None}


class Daemon:
    """Answers ``calibrate.status`` from a list; the first answer is for the constructor."""

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


def connect(*answers: dict[str, Any], **options: Any) -> tuple[CaptureFromDaemon, Daemon]:
    daemon = Daemon(*answers)
    return CaptureFromDaemon(daemon, **options), daemon  # type: ignore[arg-type]


def test_a_daemon_that_is_still_starting_is_rejected() -> None:
    daemon = Daemon()
    daemon.answers = [IDLE | {"projector": None}]
    with pytest.raises(DaemonError, match="still starting"):
        CaptureFromDaemon(daemon)  # type: ignore[arg-type]


def test_a_failed_capture_raises_the_daemons_message() -> None:
    source, _ = connect({"job": 7, "of": 1}, {"job": 7, "of": 1, "outcome": "failed", "problem": "the cable is out"})
    with pytest.raises(DaemonError, match="the cable is out"):
        source.capture(SEQUENCE)


def test_another_clients_capture_is_detected() -> None:
    source, _ = connect({"job": 8, "of": 1})
    with pytest.raises(DaemonError, match="another client captures"):
        source.capture(SEQUENCE)


def test_stopping_cancels_the_capture_in_the_daemon() -> None:
    source, daemon = connect({"job": 7, "of": 9}, cancelled=lambda: True)
    with pytest.raises(CaptureCancelledError):
        source.capture(SEQUENCE)
    assert daemon.called[-1] == "calibrate.cancel"


def test_a_capture_cancelled_in_the_daemon_is_no_device_failure() -> None:
    source, _ = connect({"job": 7, "of": 1, "outcome": "cancelled"})
    with pytest.raises(CaptureCancelledError):
        source.capture(SEQUENCE)


def test_a_file_with_fewer_images_than_requested_is_rejected(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    writer = TakeWriter(
        path, session="s", device="d", calibration_data=b"", pattern=SEQUENCE.as_mapping(), volume={}, min_free_bytes=0
    )
    sides: tuple[Side, Side] = ("left", "right")
    frames = [Frame(side, 3, 5, 6, "mono8", np.zeros((4, 4), np.uint8)) for side in sides]
    writer.offer(Pair(*frames))
    writer.close()
    source, _ = connect({"job": 7, "of": 1, "outcome": "done", "file": str(path)})
    with pytest.raises(DaemonError, match="it contains 1 of 1 images, numbered from 3"):
        source.capture(SEQUENCE)


def test_without_a_simulated_hand_nothing_moves_and_closing_ends_the_capture() -> None:
    source, daemon = connect()
    with source:
        assert not source.has_hand and not source.next_pose()
    assert daemon.called == ["calibrate.status", "calibrate.cancel", "close"]
