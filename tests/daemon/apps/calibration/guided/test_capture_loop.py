"""A whole guided session, with the rig's own devices and through a running daemon."""

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
from daemon.apps.calibration.guided.capture import Shooter, unheard
from daemon.apps.calibration.guided.capture_from_daemon import DaemonShooter
from daemon.apps.calibration.guided.capture_from_devices import DeviceShooter
from daemon.apps.calibration.guided.capture_loop import Outcome, Scene, guide
from daemon.apps.calibration.guided.session_folder import SessionFolder, png
from daemon.apps.calibration.guided.session_state import Limits, State
from daemon.apps.calibration.guided.terminal_view import Bars, Lines
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
from pipeline.pattern.sequence import FrameSequence, Fringe, Uniform, camera_sequence
from tests.daemon.apps.calibration.guided.hand_rig import BOARD, HandDevices, find, hand_devices
from tests.daemon.lit_rig import UnmeasuringService
from tests.daemon.rigs import Collector, config, rig_of
from tools.waiting import wait_until

LIMITS = Limits(steady_s=0.05, wanted=3, most=3)


class Kept:
    """A watcher that remembers."""

    def __init__(self) -> None:
        self.scenes: list[Scene] = []
        self.progress: list[tuple[int, int]] = []
        self.troubles: list[str] = []

    def seen(self, scene: Scene) -> None:
        self.scenes.append(scene)

    def capturing(self, done: int, of: int) -> None:
        self.progress.append((done, of))

    def trouble(self, text: str) -> None:
        self.troubles.append(text)


class Mender(Kept):
    """Puts the projector right at the first trouble."""

    def __init__(self, made: HandDevices) -> None:
        super().__init__()
        self._made = made

    def trouble(self, text: str) -> None:
        super().trouble(text)
        self._made.projector.trouble = ""


@contextmanager
def with_devices(tmp_path: Path, made: HandDevices) -> Iterator[Shooter]:
    with DeviceShooter(made, config(tmp_path)) as shooter:
        yield shooter


@contextmanager
def with_daemon(tmp_path: Path, made: HandDevices) -> Iterator[Shooter]:
    settings = config(tmp_path, "recording: {min_free_mb: 10}\n")
    plain = replace(made.plain, cameras=made.cameras, projector=made.projector)
    rig = replace(rig_of(plain), next_pose=made.trigger.next_pose)
    service: Service = UnmeasuringService(settings, rig, {"stream": Collector()})
    capture = Capture(
        service,
        lambda file, pattern, least: open_capture(settings, rig, "s", file, pattern, min_free_bytes=least),
        directories=(tmp_path, tmp_path / "takes"),
    )
    recorder = Recorder(service, tmp_path / "takes", lambda _: Collector())
    methods = Methods(service, recorder, path=None, base_dir=tmp_path, calibrate=CalibrateMethods(service, capture))
    server = ControlServer(settings.control.endpoint, methods.table())
    server.start()
    thread = threading.Thread(target=service.run)
    thread.start()
    try:
        wait_until(lambda: service.ready)
        with DaemonShooter(ControlClient(settings.control.endpoint)) as shooter:
            yield shooter
        wait_until(lambda: not capture.active)
        clouds = service.worker.clouds
        # The simulated cameras' images have another size than the calibration, which does not keep pairs from coming.
        wait_until(lambda: service.worker.clouds > clouds)
    finally:
        service.ask_stop()
        thread.join(20)
        capture.close()
        server.close()


def short_sequence(size: tuple[int, int]) -> FrameSequence:
    return FrameSequence(
        "projector",
        (Uniform(size, (192, 192, 192)), Uniform(size, (0, 0, 0)), Fringe(size, 4.0), Fringe(size, 4.0, "y")),
    )


def guided(shooter: Shooter, folder: Path, sequence: FrameSequence, **options: Any) -> tuple[Outcome, Kept]:
    kept = Kept()
    outcome = guide(
        shooter, BOARD, sequence, folder, find=find, watcher=kept, clock=SystemClock(),
        **({"limits": LIMITS} | options),
    )  # fmt: skip
    return outcome, kept


@pytest.mark.parametrize("through", [with_devices, with_daemon], ids=["devices", "daemon"])
def test_a_session_runs_by_itself_from_the_first_pose_to_a_folder_that_can_be_solved(
    through: Any, tmp_path: Path
) -> None:
    made = hand_devices()
    with through(tmp_path, made) as shooter:
        sequence = short_sequence(shooter.size)
        outcome, kept = guided(shooter, tmp_path / "session" / "board", sequence)
    assert outcome.views == 3 and made.trigger.moves == 2
    assert kept.scenes[-1].session.state is State.DONE and not kept.troubles
    assert (4, 4) in kept.progress
    source = CaptureFolder(tmp_path / "session" / "board")
    assert source.sequence is not None and source.sequence.as_mapping() == sequence.as_mapping()
    views = list(source.views(unheard))
    assert [view.name for view in views] == ["view_00", "view_01", "view_02"]
    for pose, view in enumerate(views):
        light = []
        for side, images in enumerate((view.left, view.right)):
            assert [tuple(image[0, 0]) for image in images] == [(pose, side, 77)] * 4
            light.append([int(image[1, 1].max()) for image in images])
        first = [int(frame.image()[0, 0].max()) for frame in sequence.frames]
        assert light == [first, first], "every image shows its frame"


def test_the_devices_are_dark_and_closed_afterwards(tmp_path: Path) -> None:
    made = hand_devices()
    with with_devices(tmp_path, made) as shooter:
        shooter.shoot(camera_sequence(shooter.size))
    assert made.projector.level == 0
    assert {str(camera.state) for camera in made.cameras.values()} == {"closed"}


def test_what_was_captured_stays_when_somebody_stops_the_session(tmp_path: Path) -> None:
    made = hand_devices()
    with with_devices(tmp_path, made) as shooter:
        outcome, _ = guided(
            shooter, tmp_path / "s", camera_sequence(shooter.size), stopped=lambda: made.trigger.moves >= 2
        )
    assert outcome.views == 2 and not outcome.complete
    assert len(list(CaptureFolder(tmp_path / "s").views(unheard))) == 2


def test_a_projector_that_fails_for_a_while_is_waited_for_and_one_that_stays_so_ends_the_session(
    tmp_path: Path,
) -> None:
    made = hand_devices()
    with with_devices(tmp_path, made) as shooter:
        kept = Mender(made)
        made.projector.trouble = "the cable is out"
        outcome = guide(
            shooter, BOARD, camera_sequence(shooter.size), tmp_path / "s", find=find, watcher=kept,
            clock=SystemClock(), limits=LIMITS,
        )  # fmt: skip
        assert outcome.views == 3
        made.projector.trouble = "the cable is out"
        with pytest.raises(DriverError, match="the cable is out"):
            guided(shooter, tmp_path / "t", short_sequence(shooter.size))


def test_a_session_is_never_written_into_another_one(tmp_path: Path) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "capture.json").write_text("{}")
    with pytest.raises(DaemonError, match="name another folder"):
        SessionFolder(tmp_path / "old", camera_sequence((8, 8)))


def test_a_camera_that_does_not_come_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(devices_module, "_START_S", 0.3)
    made = hand_devices(rate_hz=0.0)
    made.cameras["right"].set_present(False)
    with pytest.raises(DaemonError, match=r"camera right: .* not there"):
        DeviceShooter(made, config(tmp_path))
    assert made.projector.level == 0


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_raw_images_are_kept_bit_by_bit(dtype: type) -> None:
    grey = np.random.default_rng(1).integers(0, np.iinfo(dtype).max, (40, 50), dtype)
    assert (cv2.imdecode(np.frombuffer(png(grey), np.uint8), cv2.IMREAD_UNCHANGED) == grey).all()


def test_a_terminal_and_a_log_tell_the_same(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = hand_devices()
    with ExitStack() as stack, with_devices(tmp_path, made) as shooter:
        for name, watcher in (("lines", stack.enter_context(Lines())), ("bars", stack.enter_context(Bars()))):
            made.trigger.pose = 0
            guide(
                shooter, BOARD, short_sequence(shooter.size), tmp_path / name, find=find, watcher=watcher,
                clock=SystemClock(), limits=LIMITS,
            )  # fmt: skip
    told = capsys.readouterr().err
    assert "a new pose: hold the board still\nhold still\n" in told
    assert "image 4 of 4\n" in told and "view 3 of 3 is taken; nothing is missing\n" in told
    assert "3 of 3 views" in told
    assert json.loads((tmp_path / "bars" / "capture.json").read_text())["encoding"] == "rgb8"
