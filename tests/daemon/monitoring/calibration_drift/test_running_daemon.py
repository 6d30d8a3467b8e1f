"""A running simulated daemon reports a disturbed camera within seconds, and its recovery."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.bootstrap.sinks import open_selfcheck
from daemon.config.rig_config import SelfCheck as Config
from daemon.live.items import CloudItem
from daemon.live.service import Service
from daemon.monitoring.calibration_drift.sink import DriftMonitor
from drivers.protocols import Frame
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.volume import Volume
from sim.devices.open_rig import open_rig
from sim.rig.layout import RigLayout
from tests.daemon.rigs import STEPPED_NS, SteppedClock, config, rig_of, step
from tools.waiting import wait_until

STEP_S = 0.2  # of the stepped clock, a trigger: every pair is examined
WITHIN = round(5 / STEP_S)
LIVE = {"live": True, "scene": "face", "rate_hz": 0.0, "layout": {"scale": 0.375}}


@contextmanager
def running(tmp_path: Path, options: dict[str, Any]) -> Iterator[tuple[Any, Service, Callable[[], None]]]:
    """A daemon of a live simulated rig, and a function that triggers it and waits until the pair was examined."""
    made = open_rig(options, tmp_path, clock=SteppedClock())
    rig = rig_of(made)
    checked = config(tmp_path)
    clock: Any = made.trigger._clock
    check = DriftMonitor(
        checked.selfcheck, tmp_path / "selfcheck", calibration=rig.calibration, pattern=rig.pattern,
        volume=rig.volume, identity=rig.identity, clock=clock,
    )  # fmt: skip
    service = Service(checked, rig, {"selfcheck": check}, clock=clock)
    thread = threading.Thread(target=service.run)
    thread.start()
    taken = 0

    def measured(pairs: int) -> bool:
        """Whether so many pairs came, and all of them were measured or dropped."""
        return service.pairer.pairs == pairs == service.worker.clouds + service.drops["pairs_pipeline_busy"]

    def trigger() -> None:
        nonlocal taken
        pairs, due = service.pairer.pairs, check._due_ns <= clock.now_ns + round(1e9 * STEP_S)
        clock.now_ns += round(1e9 * STEP_S) - STEPPED_NS
        step(made)
        wait_until(lambda: measured(pairs + 1))
        if due:
            wait_until(lambda: check.status()["checked"] > taken)
        taken = check.status()["checked"]

    try:
        wait_until(lambda: str(service.state()[0]) == "running", 120)
        for _ in range(3):  # the count of both cameras is believed after three pairs, which then come at once
            step(made)
        wait_until(lambda: measured(3))
        wait_until(lambda: check.status()["checked"] > 0)
        taken = check.status()["checked"]
        yield made, service, trigger
    finally:
        service.request_stop()
        thread.join(20)
        assert not thread.is_alive()


def _reports(text: str) -> Callable[[dict[str, Any]], bool]:
    return lambda status: str(status["state"]) == "degraded" and any(text in reason for reason in status["reasons"])


def trigger_until(service: Service, trigger: Callable[[], None], condition: Callable[[dict[str, Any]], bool]) -> int:
    """Triggers until the status is so; fails after five seconds of the rig's time."""
    for count in range(1, WITHIN + 1):
        trigger()
        if condition(service.status().as_dict()):
            return count
    raise AssertionError(f"not within {WITHIN} triggers: {service.status().selfcheck}")


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_disturbance_is_reported_within_five_seconds_and_so_is_its_end(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level("INFO", logger="fringed.selfcheck")
    with running(tmp_path, LIVE) as (made, service, trigger):
        for _ in range(WITHIN + round(1 / STEP_S)):
            trigger()
        status = service.status()
        assert status.selfcheck["verdict"] == "ok" and not status.reasons, status.selfcheck
        disturbances: list[tuple[str, dict[str, Any], str]] = [
            ("right", {"turn_deg": (0.0, 0.01, 0.0)}, "trinocular residual"),
            ("left", {"shift_px": (0.0, 0.2)}, "epipolar residual"),
            ("right", {"crosstalk": 0.03}, "crosstalk of the right camera"),
        ]
        for side, change, text in disturbances:
            made.trigger.disturb(side, **change)
            trigger_until(service, trigger, _reports(text))
            back = {k: tuple(-x for x in v) if isinstance(v, tuple) else -v for k, v in change.items()}
            made.trigger.disturb(side, **back)
            trigger_until(service, trigger, lambda s: str(s["state"]) == "running")
    rows = [json.loads(line) for line in (tmp_path / "selfcheck" / "history.jsonl").read_text().splitlines()]
    assert [row["event"] for row in rows if row["event"] in ("drifted", "ok")] == ["drifted", "ok"] * 3
    assert rows[-1]["event"] == "stopped"
    assert caplog.text.count("self-check: the rig matches its calibration again") == 3
    known = json.loads((tmp_path / "selfcheck" / "references.json").read_text())["calibrations"]
    assert len(known) == 1


def item(clock: SteppedClock, *, encoding: str = "rgb8") -> CloudItem:
    """A pair of noise without a surface."""
    width, height = RigLayout().scaled(0.125).camera_size
    image = np.random.default_rng(0).integers(40, 200, (height, width, 3), dtype=np.uint8)
    image.setflags(write=False)
    frames = [Frame(side, 1, clock.now_ns, clock.now_ns, encoding, image) for side in ("left", "right")]  # type: ignore[arg-type]
    nothing = np.full((height, width, 3), np.nan, np.float32)
    plane = np.zeros((height, width), np.uint8)
    cloud = Cloud(nothing, nothing[..., 0], plane, (plane, plane), np.zeros((height, width), np.int16))
    return CloudItem(1, clock.now_ns, cloud, *frames, latency_ms=1.0)


def sink(tmp_path: Path, clock: SteppedClock, **options: Any) -> DriftMonitor:
    layout = RigLayout().scaled(0.125)
    volume: Volume = layout.volume()
    return DriftMonitor(
        Config(**options), tmp_path / "check", calibration=layout.calibration(), pattern=layout.pattern(),
        volume=volume, identity="sha256:0", clock=clock,
    )  # fmt: skip


def test_only_pairs_that_are_due_are_examined(tmp_path: Path) -> None:
    clock = SteppedClock()
    check = sink(tmp_path, clock, rate_hz=5.0)
    try:
        for _ in range(20):
            clock.now_ns += 200_000_000
            before = check.status()["checked"]
            for _ in range(3):
                assert check.offer(item(clock))
            wait_until(lambda before=before: check.status()["checked"] == before + 1)
        status = check.status()
        assert (
            status["checked"] == 20 and status["problem"] == "" and status["verdict"] in ("learning", "not observable")
        )
        json.dumps(status)
    finally:
        check.close()
    assert check.offer(item(clock)) and check.status()["checked"] == 20


def test_images_that_do_not_fit_are_a_problem_and_no_crash(tmp_path: Path) -> None:
    clock = SteppedClock()
    check = sink(tmp_path, clock)
    try:
        check.offer(item(clock, encoding="bayer_rggb8"))
        wait_until(lambda: "left image is" in check.status()["problem"])
        clock.now_ns += 1_000_000_000
        check.offer(item(clock))
        wait_until(lambda: check.status()["problem"] == "")
    finally:
        check.close()


def test_it_is_made_from_rig_yaml(tmp_path: Path) -> None:
    made = open_rig({"frames": 1, "rate_hz": 0.0, "layout": {"scale": 0.125}}, tmp_path, images=_Nothing())
    check = open_selfcheck(
        config(tmp_path, "selfcheck: {dir: there, limits: {column_px: 0.1}}\n"), rig_of(made), tmp_path
    )
    try:
        assert check.status()["verdict"] in ("learning", "not observable")
    finally:
        check.close()
        made.close()


class _Nothing:
    def pair(self, index: int) -> tuple[Any, Any]:
        raise AssertionError(f"trigger {index} was not requested")
