"""A daemon in a multi-frame mode: captures, plain images, pauses, troubles and other modes, and back to its sets."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from daemon.bootstrap.sinks import open_capture
from daemon.common.errors import ConfigError
from daemon.config import parse_rig
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.methods import Methods
from daemon.control.rpc.protocol import RpcError
from daemon.control.sequence_capture import Capture
from daemon.live.items import Pair
from daemon.live.status import State
from daemon.recording.recorder import Recorder
from tests.daemon.live.projection.mode_rigs import Lit, lit
from tests.daemon.rigs import Collector
from tools.waiting import wait_until


class Desk:
    """The daemon as its control socket sees it."""

    def __init__(self, bench: Lit) -> None:
        self.bench, service, path = bench, bench.service, bench.path
        (path / "run").mkdir()
        self.capture = Capture(
            service,
            lambda file, pattern, least: open_capture(
                bench.config, service.rig, "s", file, pattern, min_free_bytes=least
            ),
            directories=(path / "run", path / "takes"),
        )
        self.recorder = recorder = Recorder(
            service.router, service.config, path / "takes", lambda _: Writing(), clock=service.clock
        )
        calibrate = CalibrateMethods(service, self.capture)
        self.methods = Methods(service, recorder, path=None, base_dir=path, calibrate=calibrate)

    def call(self, method: str, /, **params: object) -> Any:
        return self.methods.table()[method](dict(params))


class Writing(Collector):
    def status(self) -> dict[str, Any]:
        return super().status() | {"recording": True}


@pytest.fixture
def desk(tmp_path: Path) -> Iterator[Desk]:
    with lit(tmp_path, "mode: gray\nsequence: {settle_ms: 6, steps: 4}\n") as bench:
        made = Desk(bench)
        yield made
        made.capture.close()


def test_every_set_holds_each_image_in_its_order(desk: Desk) -> None:
    desk.bench.goes_on(4)
    assert len(desk.bench.levels) > 4
    assert all(one == desk.bench.levels for one in desk.bench.service.seen)
    assert desk.call("pattern.mode")["mode"] == desk.call("get", path="mode") == "gray"
    assert len(desk.bench.sink.pairs) >= 4 * len(desk.bench.levels)


def test_a_capture_has_the_projector_alone_and_the_sets_go_on_afterwards(desk: Desk) -> None:
    size = list(desk.bench.projector.size)
    frames = [{"kind": "uniform", "size": size, "color": [level] * 3} for level in (10, 200, 30)]
    desk.call("calibrate.capture", frames=frames, pairs=3)
    wait_until(lambda: desk.call("calibrate.status")["outcome"])
    assert desk.call("calibrate.status")["outcome"] == "done"
    wait_until(lambda: desk.bench.service.state()[0] is State.RUNNING)
    desk.bench.goes_on()
    assert all(one == desk.bench.levels for one in desk.bench.service.seen)


def test_nothing_is_measured_under_a_plain_image(desk: Desk) -> None:
    desk.call("pattern.show", name="white")
    assert desk.bench.projector.level == 255 and desk.call("pattern.mode")["held"] == ["image"]
    shown = len(desk.bench.projector.shown)
    triggers = desk.bench.service.pairer.pairs
    wait_until(lambda: desk.bench.service.pairer.pairs > triggers + 20)
    assert len(desk.bench.projector.shown) == shown
    desk.call("pattern.show", name="fringe")
    desk.bench.goes_on()


def test_a_pause_ends_the_set_and_a_start_begins_one(desk: Desk) -> None:
    desk.bench.goes_on(1)
    desk.call("stop")
    wait_until(lambda: all(c.status.state == "paused" for c in desk.bench.service.cameras.values()))
    desk.call("start")
    desk.bench.goes_on()
    wait_until(lambda: desk.bench.service.status().reasons == ())


def test_a_projector_in_trouble_degrades_the_daemon_and_lights_the_scene_again(desk: Desk) -> None:
    desk.bench.projector.trouble = "the lamp is out"
    wait_until(lambda: any("sequence: " in reason for reason in desk.bench.service.state()[1]))
    desk.bench.projector.trouble = ""
    wait_until(lambda: desk.bench.service.state()[0] is State.RUNNING)
    desk.bench.goes_on()
    assert all(one == desk.bench.levels for one in desk.bench.service.seen)


def test_the_mode_changes_live_there_and_back(desk: Desk) -> None:
    gray = desk.bench.levels
    assert desk.call("pattern.mode", name="heterodyne")["frames"] == 12
    desk.bench.goes_on()
    heterodyne = desk.bench.levels
    assert desk.call("pattern.mode", name="single") == {"mode": "single"}
    pairs = len(desk.bench.sink.pairs)
    desk.bench.goes_on()
    rig = desk.bench.service.rig
    fringe = int(rig.pattern.image(rig.calibration.response)[0, 0].max())
    assert all((item.left.image == fringe).all() for item in desk.bench.sink.pairs[pairs + 1 :])
    desk.call("pattern.mode", name="gray")
    desk.bench.goes_on()
    assert all(one in (gray, heterodyne) for one in desk.bench.service.seen)


def test_a_take_that_begins_in_the_past_holds_nothing_of_another_mode(desk: Desk) -> None:
    desk.call("set", path="recording.before_s", value=60.0)
    desk.bench.goes_on(2)
    assert desk.recorder.status()["before"]["items"] > len(desk.bench.levels)
    desk.call("pattern.mode", name="heterodyne")
    sets = desk.bench.service.mode_controller.sets
    wait_until(lambda: desk.bench.service.mode_controller.sets >= sets + 2)
    kept = [item.left for item in desk.recorder._pretrigger.last(60.0) if isinstance(item, Pair)]
    levels = desk.bench.levels
    assert len(kept) >= 2 * len(levels)
    assert [int(frame.image[0, 0, 0]) for frame in kept] == [levels[frame.trigger % len(levels)] for frame in kept]


def test_a_mode_that_cannot_be_leaves_the_one_there_is(desk: Desk) -> None:
    with pytest.raises(RpcError, match="mode"):
        desk.call("pattern.mode", name="fast")
    desk.call("record.start", name="a")
    with pytest.raises(RpcError, match="a take is being written"):
        desk.call("pattern.mode", name="single")
    desk.call("record.stop")
    desk.bench.projector.trouble = "the lamp is out"
    with pytest.raises(RpcError, match="the lamp is out"):
        desk.call("pattern.mode", name="heterodyne")
    desk.bench.projector.trouble = ""
    assert desk.call("pattern.mode")["mode"] == "gray"
    desk.bench.goes_on()


CAMERAS = "calibration: c\npattern: p\nvolume: {near_mm: 1, far_mm: 2}\ncameras: {driver: genicam}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cameras: {driver: sim}\nmode: grey\n", "rig.yaml:2:7: mode"),
        ("cameras: {driver: sim}\nmode: gray\nsimulation: {live: false}\n", "rig.yaml:3:20: simulation.live is false"),
        (CAMERAS + "projector: {driver: external}\nmode: gray\n", "sequence.display: stored"),
        (CAMERAS + "projector: {driver: x11}\nmode: gray\nsequence: {display: stored}\n", "x11 holds no images"),
        ("cameras: {driver: sim}\nmode: gray\nsequence: {steps: 2}\n", "rig.yaml:3:19: sequence.steps"),
    ],
)  # fmt: skip
def test_a_mode_that_the_rig_cannot_show_is_refused_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig(text)
    assert message in str(caught.value)
