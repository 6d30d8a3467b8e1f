"""The live view shows images, marks, coverage and advice, and delays nothing."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.apps.calibration.guided import rerun_view as viewer_module
from daemon.apps.calibration.guided.capture_loop import SessionUpdate
from daemon.apps.calibration.guided.rerun_view import RerunDisplay, advice_text, downscale, live_view
from daemon.apps.calibration.guided.session_state import Observation, Session
from daemon.apps.viewer.rerun_targets import file_recording
from daemon.common.errors import DaemonError
from tests.daemon.apps.calibration.guided.hand_rig import BOARD, SIZES, VIEWS
from tests.daemon.apps.calibration.guided.test_session_state import LIMITS, Clock, held, observation
from tests.daemon.apps.viewer import rrd_contents


def update(*, accepted: int = 0) -> SessionUpdate:
    session, clock = Session(BOARD, SIZES, limits=LIMITS), Clock()
    for view in VIEWS[:accepted]:
        held(session, view, clock)
    now = observation(VIEWS[accepted], clock.next())
    image = np.full((SIZES["left"][1], SIZES["left"][0], 3), 90, np.uint8)
    return SessionUpdate({"left": image, "right": image}, now, session.observe(now), session)


def test_images_marks_coverage_outline_and_figures_reach_the_file(tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    with file_recording(file) as recording:
        display = RerunDisplay(recording)
        display.show(update(accepted=2))
        display.close()
    entities = rrd_contents.entities(file)
    sides = {f"/images/{side}{part}" for side in ("left", "right") for part in ("", "/marks", "/covered")}
    figures = {f"/figures/{name}/{side}" for name in ("sharpness_px", "saturated") for side in ("left", "right")}
    assert sides | figures | {"/images/left/next", "/now", "/advice"} <= entities
    (marks,) = rrd_contents.rows(file, "/images/left/marks", "Points2D:positions", "observation").values()
    scale = viewer_module.WIDTH_PX / SIZES["left"][0]
    assert np.allclose(np.asarray(marks.tolist()), VIEWS[2].marks["left"].pixels * scale, atol=1e-3)
    (covered,) = rrd_contents.rows(file, "/images/right/covered", "Points2D:positions", "observation").values()
    assert len(covered) == sum(len(view.marks["right"]) for view in VIEWS[:2])


def test_an_observation_without_marks_is_shown_too(tmp_path: Path) -> None:
    session = Session(BOARD, SIZES, limits=LIMITS)
    empty = Observation(1.0, {}, {"left": "no circles", "right": "no circles"})
    image = np.zeros((820, 1024), np.uint16)
    with file_recording(tmp_path / "x.rrd") as recording:
        display = RerunDisplay(recording)
        display.show(SessionUpdate({"left": image, "right": image}, empty, session.observe(empty), session))
        display.close()
    assert "/images/left" in rrd_contents.entities(tmp_path / "x.rrd")


class HangingRecording:
    """A recording that blocks until it is released."""

    def __init__(self) -> None:
        self.released, self.asked = threading.Event(), threading.Event()
        self.logged = 0

    def send_blueprint(self, _: Any) -> None:
        pass

    def set_time(self, *_: Any, **__: Any) -> None:
        self.asked.set()
        self.released.wait(30)

    def log(self, *_: Any) -> None:
        self.logged += 1


def test_a_viewer_that_hangs_delays_nothing_and_gets_the_newest_update_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(viewer_module, "_JOIN_S", 0.05)
    recording = HangingRecording()
    display, newest = RerunDisplay(recording), update()
    display.show(newest)
    assert recording.asked.wait(10)
    for _ in range(100):
        display.show(newest)
    display.close()
    assert recording.logged == 0 and display._thread.is_alive()
    recording.released.set()
    display._thread.join(10)
    assert not display._thread.is_alive() and display._logged == 2


def test_without_a_viewer_the_session_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    messages: list[str] = []
    with live_view("none", messages.append) as display:
        assert display is None

    def broken() -> Any:
        raise DaemonError("it needs a screen")

    monkeypatch.setattr("daemon.apps.viewer.rerun_targets.native_recording", broken)
    with live_view("native", messages.append) as display:
        assert display is None
    assert messages == ["no live view: it needs a screen"]


def test_the_address_of_a_web_viewer_is_reported() -> None:
    messages: list[str] = []
    with live_view("web", messages.append) as display:
        assert display is not None
        display.show(update())
    assert messages[0].startswith("live view: http://127.0.0.1:")


def test_the_advice_states_the_accepted_and_the_missing_views() -> None:
    text = advice_text(update(accepted=1))
    assert "**1 of 4 views**" in text and "\n\nnext: " in text and "- " in text


def test_large_and_deep_images_are_shown_small() -> None:
    small, scale = downscale(np.full((820, 1280), 60_000, np.uint16))
    assert small.shape == (410, 640) and small.dtype == np.uint8 and small[0, 0] == 60_000 >> 8 and scale == 0.5
    same, one = downscale(np.zeros((10, 20, 3), np.uint8))
    assert same.shape == (10, 20, 3) and one == 1.0
