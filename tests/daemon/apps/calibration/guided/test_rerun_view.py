"""The live view shows what there is to see, and holds nothing up."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.apps.calibration.guided import rerun_view as viewer_module
from daemon.apps.calibration.guided.capture_loop import Scene
from daemon.apps.calibration.guided.rerun_view import Shown, advice_text, shrunk, viewer
from daemon.apps.calibration.guided.session_state import Session, Sight
from daemon.apps.viewer.rerun_targets import file_recording
from daemon.common.errors import DaemonError
from tests.daemon.apps.calibration.guided.hand_rig import BOARD, SIZES, VIEWS
from tests.daemon.apps.calibration.guided.test_session_state import LIMITS, Clock, held, sight
from tests.daemon.apps.viewer import rrd_contents


def scene(*, taken: int = 0) -> Scene:
    session, clock = Session(BOARD, SIZES, limits=LIMITS), Clock()
    for view in VIEWS[:taken]:
        held(session, view, clock)
    now = sight(VIEWS[taken], clock.next())
    image = np.full((SIZES["left"][1], SIZES["left"][0], 3), 90, np.uint8)
    return Scene({"left": image, "right": image}, now, session.look(now), session)


def test_images_marks_coverage_outline_and_figures_reach_the_file(tmp_path: Path) -> None:
    file = tmp_path / "x.rrd"
    with file_recording(file) as recording:
        shown = Shown(recording)
        shown.seen(scene(taken=2))
        shown.close()
    entities = rrd_contents.entities(file)
    sides = {f"/images/{side}{part}" for side in ("left", "right") for part in ("", "/marks", "/covered")}
    figures = {f"/figures/{name}/{side}" for name in ("sharpness_px", "saturated") for side in ("left", "right")}
    assert sides | figures | {"/images/left/next", "/now", "/advice"} <= entities
    (marks,) = rrd_contents.rows(file, "/images/left/marks", "Points2D:positions", "look").values()
    scale = viewer_module.WIDTH_PX / SIZES["left"][0]
    assert np.allclose(np.asarray(marks.tolist()), VIEWS[2].marks["left"].pixels * scale, atol=1e-3)
    (covered,) = rrd_contents.rows(file, "/images/right/covered", "Points2D:positions", "look").values()
    assert len(covered) == sum(len(view.marks["right"]) for view in VIEWS[:2])


def test_a_look_without_marks_is_shown_too(tmp_path: Path) -> None:
    session = Session(BOARD, SIZES, limits=LIMITS)
    empty = Sight(1.0, {}, {"left": "no circles", "right": "no circles"})
    image = np.zeros((820, 1024), np.uint16)
    with file_recording(tmp_path / "x.rrd") as recording:
        shown = Shown(recording)
        shown.seen(Scene({"left": image, "right": image}, empty, session.look(empty), session))
        shown.close()
    assert "/images/left" in rrd_contents.entities(tmp_path / "x.rrd")


class Hanging:
    """A recording that takes nothing until it is let go."""

    def __init__(self) -> None:
        self.free, self.asked = threading.Event(), threading.Event()
        self.logged = 0

    def send_blueprint(self, _: Any) -> None:
        pass

    def set_time(self, *_: Any, **__: Any) -> None:
        self.asked.set()
        self.free.wait(30)

    def log(self, *_: Any) -> None:
        self.logged += 1


def test_a_viewer_that_hangs_holds_up_nothing_and_gets_the_newest_look_afterwards(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(viewer_module, "_JOIN_S", 0.05)
    recording = Hanging()
    shown, some = Shown(recording), scene()
    shown.seen(some)
    assert recording.asked.wait(10)
    for _ in range(100):
        shown.seen(some)
    shown.close()
    assert recording.logged == 0 and shown._thread.is_alive()
    recording.free.set()
    shown._thread.join(10)
    assert not shown._thread.is_alive() and shown._looks == 2


def test_without_a_viewer_the_session_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    said: list[str] = []
    with viewer("none", said.append) as shown:
        assert shown is None

    def broken() -> Any:
        raise DaemonError("it needs a screen")

    monkeypatch.setattr("daemon.apps.viewer.rerun_targets.native_recording", broken)
    with viewer("native", said.append) as shown:
        assert shown is None
    assert said == ["no live view: it needs a screen"]


def test_a_web_viewer_tells_its_address() -> None:
    said: list[str] = []
    with viewer("web", said.append) as shown:
        assert shown is not None
        shown.seen(scene())
    assert said[0].startswith("live view: http://127.0.0.1:")


def test_the_words_say_what_there_is_and_what_is_missing() -> None:
    text = advice_text(scene(taken=1))
    assert "**1 of 4 views**" in text and "\n\nnext: " in text and "- " in text


def test_large_and_deep_images_are_shown_small() -> None:
    small, scale = shrunk(np.full((820, 1280), 60_000, np.uint16))
    assert small.shape == (410, 640) and small.dtype == np.uint8 and small[0, 0] == 60_000 >> 8 and scale == 0.5
    same, one = shrunk(np.zeros((10, 20, 3), np.uint8))
    assert same.shape == (10, 20, 3) and one == 1.0
