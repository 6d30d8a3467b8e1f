"""Captures through a running daemon: right images, bounds, and measuring that resumes after any outcome."""

from __future__ import annotations

import json
import random
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.bootstrap.sinks import open_capture
from daemon.control import sequence_capture as capture_module
from daemon.control.calibrate_methods import CalibrateMethods
from daemon.control.methods import Methods
from daemon.control.rpc.protocol import RpcError
from daemon.control.sequence_capture import Capture
from daemon.live.service import Service
from daemon.live.status import State
from daemon.recording.read.take_reader import TakeReader
from daemon.recording.recorder import Recorder
from tests.daemon.lit_rig import FreeProjector, UnmeasuringService, devices
from tests.daemon.rigs import Collector, config, rig_of
from tools.waiting import wait_until


@dataclass
class Bench:
    service: Service
    methods: Methods
    capture: Capture
    projector: FreeProjector
    sink: Collector
    path: Path

    def call(self, method: str, /, **params: object) -> Any:
        return self.methods.table()[method](params)

    def frames(self, *levels: int) -> list[dict[str, Any]]:
        size = list(self.projector.size)
        return [{"kind": "uniform", "size": size, "color": [level] * 3} for level in levels]

    def ended(self) -> dict[str, Any]:
        wait_until(lambda: self.call("calibrate.status")["outcome"])
        return dict(self.call("calibrate.status"))

    def measures_again(self) -> None:
        wait_until(lambda: self.service.state()[0] is State.RUNNING)
        clouds = self.service.worker.clouds
        wait_until(lambda: self.service.worker.clouds > clouds + 2)
        assert self.projector.shown[-1] == self.fringe

    @property
    def fringe(self) -> int:
        return int(self.service.rig.pattern.image(self.service.rig.calibration.response)[0, 0].max())


@contextmanager
def running(path: Path) -> Iterator[Bench]:
    made, projector, _ = devices()
    sink = Collector()
    rig, settings = rig_of(made), config(path, "recording: {min_free_mb: 10}\n")
    service = UnmeasuringService(settings, rig, {"stream": sink})
    (path / "run").mkdir()
    capture = Capture(
        service,
        lambda file, pattern, least: open_capture(
            settings, rig, "s", file, pattern, serials=service.path.serials, min_free_bytes=least
        ),
        directories=(path / "run", path / "takes"),
    )
    recorder = Recorder(service.router, service.config, path / "takes", lambda _: Collector(), clock=service.clock)
    calibrate = CalibrateMethods(service, capture)
    methods = Methods(service, recorder, path=None, base_dir=path, calibrate=calibrate)
    thread = threading.Thread(target=service.run)
    bench = Bench(service, methods, capture, projector, sink, path)
    with pytest.raises(RpcError, match="still starting"):
        bench.call("calibrate.capture", frames=bench.frames(1))
    thread.start()
    wait_until(lambda: service.state()[0] is State.RUNNING, 60)
    yield bench
    service.request_stop()
    thread.join(20)
    capture.close()
    assert not list((path / "run").iterdir()), "what was kept in memory goes with the daemon"


@pytest.fixture(scope="module")
def started(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with running(tmp_path_factory.mktemp("rig")) as bench:
        yield bench


@pytest.fixture
def bench(started: Bench) -> Iterator[Bench]:
    yield started
    started.projector.trouble = ""
    started.call("calibrate.cancel")
    started.measures_again()


def test_each_pair_of_the_take_shows_its_frame_and_nothing_of_it_is_measured(bench: Bench) -> None:
    levels = [10, 200, 30, 90, 91]
    bench.sink.items.clear()
    job = bench.call("calibrate.capture", frames=bench.frames(*levels), pairs=2, name="five")
    assert job["frames"] == 5
    status = bench.ended()
    assert status["outcome"] == "done" and (status["done"], status["of"]) == (10, 10)
    with TakeReader(Path(status["file"])) as take:
        assert take.whole and take.metadata["first_pattern_sequence"] == "0"
        sequence = json.loads(take.attachments["pattern.json"])
        assert sequence["name"] == "five" and [f["color"][0] for f in sequence["frames"]] == levels
        pairs = sorted(take.pairs(), key=lambda pair: pair.sequence)
    assert [pair.sequence for pair in pairs] == list(range(10))
    for pair in pairs:
        assert set(np.unique(pair.left)) == set(np.unique(pair.right)) == {levels[pair.sequence % 5]}
    bench.measures_again()
    shown = {int(item.left.image.max()) for item in bench.sink.pairs}
    assert shown == {bench.fringe}, "sinks get pairs under the fringe alone"


def test_while_it_holds_the_status_gives_the_reason_and_the_last_image_stays(bench: Bench) -> None:
    first = bench.call("calibrate.capture", frames=bench.frames(77), hold_s=30)["job"]
    bench.ended()
    assert bench.call("calibrate.status")["state"] == "holding"
    assert bench.service.state() == (State.PAUSED, ("calibrating",))
    shown, clouds = list(bench.projector.shown), bench.service.worker.clouds
    assert bench.call("calibrate.capture", frames=bench.frames(77), hold_s=30)["job"] == first + 1
    assert bench.ended()["outcome"] == "done"
    assert bench.projector.shown == shown, "the image that is there already is not shown again"
    assert bench.service.worker.clouds == clouds
    with pytest.raises(RpcError, match="showing images for a capture"):
        bench.call("pattern.show", name="fringe")
    assert bench.call("calibrate.cancel")["job"] == first + 1
    bench.measures_again()
    assert bench.call("calibrate.status")["state"] == "idle"


def test_a_hold_ends_by_itself(bench: Bench) -> None:
    bench.call("calibrate.capture", frames=bench.frames(5), hold_s=0.1)
    bench.ended()
    bench.measures_again()


def test_one_capture_at_a_time_and_it_can_be_cancelled(bench: Bench) -> None:
    job = bench.call("calibrate.capture", frames=bench.frames(*range(1, 201)), pairs=4)["job"]
    with pytest.raises(RpcError, match=f"capture {job} is running"):
        bench.call("calibrate.capture", frames=bench.frames(1))
    bench.call("calibrate.cancel")
    status = bench.ended()
    assert status["outcome"] == "cancelled" and status["file"] is None
    bench.measures_again()
    assert not list(bench.path.glob("*/*.partial"))


def test_a_capture_whose_client_died_is_cancelled(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "ABANDONED_S", 0.2)
    bench.call("calibrate.capture", frames=bench.frames(*range(1, 201)), pairs=4)
    wait_until(lambda: bench.service.state()[0] is State.PAUSED)
    bench.measures_again()
    assert bench.call("calibrate.status")["outcome"] == "cancelled"


def test_a_failing_projector_ends_the_capture_with_its_message(bench: Bench) -> None:
    bench.projector.trouble = "no image: the cable is out"
    bench.call("calibrate.capture", frames=bench.frames(1, 2))
    status = bench.ended()
    assert status["outcome"] == "failed" and "the cable is out" in status["problem"]
    wait_until(lambda: bench.service.state()[0] is not State.PAUSED)
    bench.projector.trouble = ""
    bench.call("pattern.show", name="fringe")


def test_a_daemon_that_was_stopped_before_is_stopped_afterwards(bench: Bench) -> None:
    bench.call("stop")
    bench.call("calibrate.capture", frames=bench.frames(50))
    assert bench.ended()["outcome"] == "done"
    wait_until(lambda: not bench.capture.active)
    assert bench.service.state()[0] is State.PAUSED and bench.service.state()[1] == ()
    bench.call("start")


def test_only_the_last_captures_are_kept(bench: Bench) -> None:
    for level in range(1, 7):
        bench.call("calibrate.capture", frames=bench.frames(level), hold_s=5)
        bench.ended()
    assert len(list(bench.path.glob("run/capture*.mcap"))) == 4


def test_clients_that_start_and_cancel_as_they_like_never_leave_it_stuck(bench: Bench) -> None:
    def client(seed: int) -> None:
        rng = random.Random(seed)
        for _ in range(25):
            try:
                if rng.random() < 0.6:
                    levels = [rng.randrange(1, 250) for _ in range(rng.randrange(1, 4))]
                    bench.call("calibrate.capture", frames=bench.frames(*levels), hold_s=rng.choice([0, 0.05]))
                else:
                    bench.call("calibrate.cancel")
            except RpcError as error:
                assert "is running" in error.message
            threading.Event().wait(rng.uniform(0, 0.08))

    clients = [threading.Thread(target=client, args=(seed,)) for seed in range(3)]
    for thread in clients:
        thread.start()
    for thread in clients:
        thread.join(60)
    wait_until(lambda: bench.call("calibrate.status")["state"] == "idle" and not bench.capture.active)
    assert not [thread for thread in threading.enumerate() if thread.name == "capture"]
    bench.call("calibrate.capture", frames=bench.frames(33))
    assert bench.ended()["outcome"] == "done"


@pytest.mark.parametrize(
    ("params", "path"),
    [
        ({}, "frames"),
        ({"frames": []}, "frames"),
        ({"frames": 5}, "frames"),
        ({"frames": [{"kind": "plaid"}]}, "frames[0].kind"),
        ({"frames": [{"kind": "uniform", "size": [8, 8], "color": [1, 2, 3]}]}, "frames[0].size"),
        ({"frames": [{"kind": "uniform", "size": [8, 8], "color": [1, 2, 300]}]}, "frames[0].color"),
        ({"frames": [{"kind": "fringe", "size": [8, 8]}]}, "frames[0].periods"),
        ({"pairs": 0}, "pairs"),
        ({"pairs": 1.5}, "pairs"),
        ({"pairs": True}, "pairs"),
        ({"hold_s": 1e9}, "hold_s"),
        ({"hold_s": "x"}, "hold_s"),
        ({"name": 7}, "name"),
        ({"response": {"levels": [0, 255]}}, "response"),
        ({"response": {key: [0, 1] for key in ("levels", "red", "green", "blue")}}, "response"),
        ({"response": {key: ["a", {}] for key in ("levels", "red", "green", "blue")}}, "response"),
    ],
)
def test_bad_parameters_are_refused_with_their_name(bench: Bench, params: dict[str, Any], path: str) -> None:
    given = params if "frames" in params or not params else {"frames": bench.frames(1)} | params
    with pytest.raises(RpcError) as caught:
        bench.call("calibrate.capture", **given)
    assert caught.value.path == path, caught.value.message
    assert path.partition("[")[0] in caught.value.message


def test_too_much_is_refused(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(capture_module, "MOST_BYTES", 100_000)
    with pytest.raises(RpcError, match="capture fewer at a time"):
        bench.call("calibrate.capture", frames=bench.frames(1, 2, 3), pairs=64)


def test_a_hand_is_only_where_one_is_simulated(bench: Bench) -> None:
    with pytest.raises(RpcError, match="move the board yourself"):
        bench.call("calibrate.next_pose")


def test_a_daemon_that_stops_in_the_middle_of_a_capture_stops_and_leaves_nothing_behind(tmp_path: Path) -> None:
    with running(tmp_path) as bench:
        bench.call("calibrate.capture", frames=bench.frames(*range(1, 201)), pairs=4)
        wait_until(lambda: bench.call("calibrate.status")["done"] > 3)
    status = bench.capture.status()
    assert status["outcome"] in ("cancelled", "failed") and status["state"] == "idle"
    assert not list(tmp_path.glob("*/*.partial"))
    assert bench.service.state()[0] is State.STOPPING
