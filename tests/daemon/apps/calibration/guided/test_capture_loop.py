"""A complete guided session, with the rig's own devices and through a running daemon."""

from __future__ import annotations

import json
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from daemon.apps.calibration.guided import capture_from_devices as devices_module
from daemon.apps.calibration.guided.capture import ImageCapture, no_progress
from daemon.apps.calibration.guided.capture_from_daemon import CaptureFromDaemon
from daemon.apps.calibration.guided.capture_from_devices import CaptureFromDevices
from daemon.apps.calibration.guided.capture_loop import Outcome, SessionUpdate, guide
from daemon.apps.calibration.guided.session_folder import SessionFolder, png
from daemon.apps.calibration.guided.session_state import Limits, State
from daemon.apps.calibration.guided.terminal_view import PlainDisplay, ProgressDisplay
from daemon.apps.calibration.views.open_source import CaptureFolder
from daemon.bootstrap.sinks import open_capture
from daemon.common.clock import SystemClock
from daemon.common.errors import DaemonError
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.methods import Methods
from daemon.control.rpc.client import ControlClient
from daemon.control.rpc.server import ControlServer
from daemon.control.sequence_capture import Capture
from daemon.live.service import Service
from daemon.recording.recorder import Recorder
from drivers.errors import DriverError
from pipeline.pattern.projected_frames import Fringe, Uniform
from pipeline.pattern.sequence import FrameSequence, camera_sequence
from tests.daemon.apps.calibration.guided.hand_rig import BOARD, HandDevices, find, hand_devices
from tests.daemon.lit_rig import UnmeasuringService
from tests.daemon.rigs import Collector, config, rig_of
from tools.waiting import wait_until

LIMITS = Limits(steady_s=0.05, least=3, most=3)


class RecordingDisplay:
    """A display that records its calls."""

    def __init__(self) -> None:
        self.updates: list[SessionUpdate] = []
        self.progress: list[tuple[int, int]] = []
        self.troubles: list[str] = []

    def show(self, update: SessionUpdate) -> None:
        self.updates.append(update)

    def capturing(self, done: int, of: int) -> None:
        self.progress.append((done, of))

    def failure(self, text: str) -> None:
        self.troubles.append(text)


class RepairingDisplay(RecordingDisplay):
    """Repairs the projector after the first failure."""

    def __init__(self, devices: HandDevices) -> None:
        super().__init__()
        self._devices = devices

    def failure(self, text: str) -> None:
        super().failure(text)
        self._devices.projector.trouble = ""


@contextmanager
def with_devices(tmp_path: Path, devices: HandDevices) -> Iterator[ImageCapture]:
    with CaptureFromDevices(devices, config(tmp_path)) as source:
        yield source


@contextmanager
def with_daemon(tmp_path: Path, devices: HandDevices) -> Iterator[ImageCapture]:
    settings = config(tmp_path, "recording: {min_free_mb: 10}\n")
    plain = replace(devices.plain, cameras=devices.cameras, projector=devices.projector)
    rig = replace(rig_of(plain), board=devices.board)
    service: Service = UnmeasuringService(settings, rig, {"stream": Collector()})
    capture = Capture(
        service,
        lambda file, pattern, least: open_capture(
            settings, rig, "s", file, pattern, serials=service.path.serials, min_free_bytes=least
        ),
        directories=(tmp_path, tmp_path / "takes"),
    )
    recorder = Recorder(service.router, service.config, tmp_path / "takes", lambda _: Collector(), clock=service.clock)
    methods = Methods(service, recorder, path=None, base_dir=tmp_path, calibrate=CalibrateMethods(service, capture))
    server = ControlServer(settings.control.endpoint, methods.table())
    server.start()
    thread = threading.Thread(target=service.run)
    thread.start()
    try:
        wait_until(lambda: service.ready)
        with CaptureFromDaemon(ControlClient(settings.control.endpoint)) as source:
            yield source
        wait_until(lambda: not capture.active)
        clouds = service.worker.clouds
        # The simulated cameras' image size differs from the calibration; pairs arrive nevertheless.
        wait_until(lambda: service.worker.clouds > clouds)
    finally:
        service.request_stop()
        thread.join(20)
        capture.close()
        server.close()


def short_sequence(size: tuple[int, int]) -> FrameSequence:
    return FrameSequence(
        "projector",
        (Uniform(size, (192, 192, 192)), Uniform(size, (0, 0, 0)), Fringe(size, 4.0), Fringe(size, 4.0, "y")),
    )


def guided(
    source: ImageCapture, folder: Path, sequence: FrameSequence, **options: Any
) -> tuple[Outcome, RecordingDisplay]:
    display = RecordingDisplay()
    outcome = guide(
        source, BOARD, sequence, folder, find=find, display=display, clock=SystemClock(),
        **({"limits": LIMITS} | options),
    )  # fmt: skip
    return outcome, display


@pytest.mark.parametrize("through", [with_devices, with_daemon], ids=["devices", "daemon"])
def test_a_session_runs_unattended_to_a_folder_that_can_be_solved(through: Any, tmp_path: Path) -> None:
    devices = hand_devices()
    with through(tmp_path, devices) as source:
        sequence = short_sequence(source.size)
        outcome, display = guided(source, tmp_path / "session" / "board", sequence)
    assert outcome.views == 3 and devices.board.moves == 2
    assert display.updates[-1].session.state is State.DONE and not display.troubles
    assert (4, 4) in display.progress
    kept_views = CaptureFolder(tmp_path / "session" / "board")
    assert kept_views.sequence is not None and kept_views.sequence.as_mapping() == sequence.as_mapping()
    views = list(kept_views.views(no_progress))
    assert [view.name for view in views] == ["view_00", "view_01", "view_02"]
    for pose, view in enumerate(views):
        light = []
        for side, images in enumerate((view.left, view.right)):
            assert [tuple(image[0, 0]) for image in images] == [(pose, side, 77)] * 4
            light.append([int(image[1, 1].max()) for image in images])
        first = [int(frame.image()[0, 0].max()) for frame in sequence.frames]
        assert light == [first, first], "every image shows its frame"


def test_the_devices_are_dark_and_closed_afterwards(tmp_path: Path) -> None:
    devices = hand_devices()
    with with_devices(tmp_path, devices) as source:
        source.capture(camera_sequence(source.size))
    assert devices.projector.level == 0
    assert {str(camera.state) for camera in devices.cameras.values()} == {"closed"}


def test_captured_views_are_kept_when_the_user_stops_the_session(tmp_path: Path) -> None:
    devices = hand_devices()
    with with_devices(tmp_path, devices) as source:
        outcome, _ = guided(
            source, tmp_path / "s", camera_sequence(source.size), stopped=lambda: devices.board.moves >= 2
        )
    assert outcome.views == 2 and not outcome.complete
    assert len(list(CaptureFolder(tmp_path / "s").views(no_progress))) == 2


def test_a_temporary_projector_failure_is_retried_and_a_permanent_one_ends_the_session(
    tmp_path: Path,
) -> None:
    devices = hand_devices()
    with with_devices(tmp_path, devices) as source:
        display = RepairingDisplay(devices)
        devices.projector.trouble = "the cable is out"
        outcome = guide(
            source, BOARD, camera_sequence(source.size), tmp_path / "s", find=find, display=display,
            clock=SystemClock(), limits=LIMITS,
        )  # fmt: skip
        assert outcome.views == 3
        devices.projector.trouble = "the cable is out"
        with pytest.raises(DriverError, match="the cable is out"):
            guided(source, tmp_path / "t", short_sequence(source.size))


def test_a_session_is_never_written_into_another_one(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "capture.json").write_text("{}")
    with pytest.raises(DaemonError, match="name another folder"):
        SessionFolder(tmp_path / "old", camera_sequence((8, 8)))


def test_a_missing_camera_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices_module, "_START_S", 0.3)
    devices = hand_devices(rate_hz=0.0)
    devices.cameras["right"].set_present(False)
    with pytest.raises(DaemonError, match=r"camera right: .* unplugged"):
        CaptureFromDevices(devices, config(tmp_path))
    assert devices.projector.level == 0


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_raw_images_are_stored_bit_by_bit(dtype: type) -> None:
    grey = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (40, 50), dtype)
    assert (cv2.imdecode(np.frombuffer(png(grey), np.uint8), cv2.IMREAD_UNCHANGED) == grey).all()


def test_plain_lines_and_bars_show_the_same_session(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    devices = hand_devices()
    with ExitStack() as stack, with_devices(tmp_path, devices) as source:
        for name, display in (
            ("lines", stack.enter_context(PlainDisplay())),
            ("bars", stack.enter_context(ProgressDisplay())),
        ):
            devices.board.pose = 0
            guide(
                source, BOARD, short_sequence(source.size), tmp_path / name, find=find, display=display,
                clock=SystemClock(), limits=LIMITS,
            )  # fmt: skip
    output = capsys.readouterr().err
    assert "a new pose: hold the board still\nhold still\n" in output
    assert "image 4 of 4\n" in output and "view 3 of 3 accepted; nothing is missing\n" in output
    assert "3 of 3 views" in output
    assert json.loads((tmp_path / "bars" / "capture.json").read_text())["encoding"] == "rgb8"
