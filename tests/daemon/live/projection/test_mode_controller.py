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


class RunningMode:
    """A daemon in a multi-frame mode with its control methods."""

    def __init__(self, bench: Lit) -> None:
        self.bench, service, path = bench, bench.service, bench.path
        (path / "run").mkdir()
        self.capture = Capture(
            service,
            lambda file, pattern, least: open_capture(
                bench.config, service.rig, "s", file, pattern, serials=service.path.serials, min_free_bytes=least
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
def mode_rig(tmp_path: Path) -> Iterator[RunningMode]:
    with lit(tmp_path, "mode: gray\nsequence: {settle_ms: 6, steps: 4}\n") as bench:
        opened = RunningMode(bench)
        yield opened
        opened.capture.close()


def test_every_set_holds_each_image_in_its_order(mode_rig: RunningMode) -> None:
    mode_rig.bench.goes_on(4)
    assert len(mode_rig.bench.levels) > 4
    assert all(one == mode_rig.bench.levels for one in mode_rig.bench.service.seen)
    assert mode_rig.call("pattern.mode")["mode"] == mode_rig.call("get", path="mode") == "gray"
    assert len(mode_rig.bench.sink.pairs) >= 4 * len(mode_rig.bench.levels)


def test_a_capture_has_the_projector_alone_and_the_sets_go_on_afterwards(mode_rig: RunningMode) -> None:
    size = list(mode_rig.bench.projector.size)
    frames = [{"kind": "uniform", "size": size, "color": [level] * 3} for level in (10, 200, 30)]
    mode_rig.call("calibrate.capture", frames=frames, pairs=3)
    wait_until(lambda: mode_rig.call("calibrate.status")["outcome"])
    assert mode_rig.call("calibrate.status")["outcome"] == "done"
    wait_until(lambda: mode_rig.bench.service.state()[0] is State.RUNNING)
    mode_rig.bench.goes_on()
    assert all(one == mode_rig.bench.levels for one in mode_rig.bench.service.seen)


def test_nothing_is_measured_under_a_plain_image(mode_rig: RunningMode) -> None:
    mode_rig.call("pattern.show", name="white")
    assert mode_rig.bench.projector.level == 255 and mode_rig.call("pattern.mode")["held"] == ["image"]
    shown = len(mode_rig.bench.projector.shown)
    triggers = mode_rig.bench.service.pairer.pairs
    wait_until(lambda: mode_rig.bench.service.pairer.pairs > triggers + 20)
    assert len(mode_rig.bench.projector.shown) == shown
    mode_rig.call("pattern.show", name="fringe")
    mode_rig.bench.goes_on()


def test_a_pause_ends_the_set_and_a_start_begins_one(mode_rig: RunningMode) -> None:
    mode_rig.bench.goes_on(1)
    mode_rig.call("stop")
    wait_until(lambda: all(c.status.state == "paused" for c in mode_rig.bench.service.cameras.values()))
    mode_rig.call("start")
    mode_rig.bench.goes_on()
    wait_until(lambda: mode_rig.bench.service.status().reasons == ())


def test_a_projector_in_trouble_degrades_the_daemon_and_lights_the_scene_again(mode_rig: RunningMode) -> None:
    mode_rig.bench.projector.trouble = "the lamp is out"
    wait_until(lambda: any("sequence: " in reason for reason in mode_rig.bench.service.state()[1]))
    mode_rig.bench.projector.trouble = ""
    wait_until(lambda: mode_rig.bench.service.state()[0] is State.RUNNING)
    mode_rig.bench.goes_on()
    assert all(one == mode_rig.bench.levels for one in mode_rig.bench.service.seen)


def test_the_mode_changes_live_there_and_back(mode_rig: RunningMode) -> None:
    gray = mode_rig.bench.levels
    assert mode_rig.call("pattern.mode", name="heterodyne")["frames"] == 12
    mode_rig.bench.goes_on()
    heterodyne = mode_rig.bench.levels
    assert mode_rig.call("pattern.mode", name="single") == {"mode": "single"}
    pairs = len(mode_rig.bench.sink.pairs)
    mode_rig.bench.goes_on()
    rig = mode_rig.bench.service.rig
    fringe = int(rig.pattern.image(rig.calibration.response)[0, 0].max())
    assert all((item.left.image == fringe).all() for item in mode_rig.bench.sink.pairs[pairs + 1 :])
    mode_rig.call("pattern.mode", name="gray")
    mode_rig.bench.goes_on()
    assert all(one in (gray, heterodyne) for one in mode_rig.bench.service.seen)


def test_a_take_that_begins_in_the_past_holds_nothing_of_another_mode(mode_rig: RunningMode) -> None:
    mode_rig.call("set", path="recording.before_s", value=60.0)
    mode_rig.bench.goes_on(2)
    assert mode_rig.recorder.status()["before"]["items"] > len(mode_rig.bench.levels)
    mode_rig.call("pattern.mode", name="heterodyne")
    sets = mode_rig.bench.service.mode_controller.sets
    wait_until(lambda: mode_rig.bench.service.mode_controller.sets >= sets + 2)
    kept = [item.left for item in mode_rig.recorder._pretrigger.last(60.0) if isinstance(item, Pair)]
    levels = mode_rig.bench.levels
    assert len(kept) >= 2 * len(levels)
    assert [int(frame.image[0, 0, 0]) for frame in kept] == [levels[frame.trigger % len(levels)] for frame in kept]


def test_a_mode_that_cannot_be_leaves_the_one_there_is(mode_rig: RunningMode) -> None:
    with pytest.raises(RpcError, match="mode"):
        mode_rig.call("pattern.mode", name="fast")
    mode_rig.call("record.start", name="a")
    with pytest.raises(RpcError, match="a take is being written"):
        mode_rig.call("pattern.mode", name="single")
    mode_rig.call("record.stop")
    mode_rig.bench.projector.trouble = "the lamp is out"
    with pytest.raises(RpcError, match="the lamp is out"):
        mode_rig.call("pattern.mode", name="heterodyne")
    mode_rig.bench.projector.trouble = ""
    assert mode_rig.call("pattern.mode")["mode"] == "gray"
    mode_rig.bench.goes_on()


CAMERAS = "calibration: c\npattern: p\nvolume: {near_mm: 1, far_mm: 2}\ncameras: {driver: genicam}\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("cameras: {driver: sim}\nmode: grey\n", "rig.yaml:2:7: mode"),
        ("cameras: {driver: sim}\nmode: gray\nsimulation: {live: false}\n", "rig.yaml:3:20: simulation.live is false"),
        (CAMERAS + "projector: {driver: external}\nmode: gray\n", "sequence.display: stored"),
        (CAMERAS + "projector: {driver: x11}\nmode: gray\nsequence: {display: stored}\n", "x11 stores no images"),
        ("cameras: {driver: sim}\nmode: gray\nsequence: {steps: 2}\n", "rig.yaml:3:19: sequence.steps"),
    ],
)  # fmt: skip
def test_a_mode_that_the_rig_cannot_show_is_refused_with_its_place(text: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_rig(text)
    assert message in str(caught.value)
