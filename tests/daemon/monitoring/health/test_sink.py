"""The sink in its own thread: it takes every item, evaluates statuses, responds, and survives errors."""

from __future__ import annotations

import json
import urllib.request
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from daemon.apps.health_report import page, panels
from daemon.config import RigConfig, parse_rig
from daemon.control.health_methods import HealthMethods
from daemon.control.rpc.protocol import RpcError
from daemon.monitoring.health.quantities import NAMES
from daemon.monitoring.health.sink import Health
from daemon.rig.open_rig import Rig
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.volume import Volume
from tests.daemon.live.publishing.clouds import calibration
from tests.daemon.monitoring.health.samples import SIZE, Clock, cloud, frame, pair, status
from tools.waiting import wait_until


def rig_yaml(more: str = "margin: 0.1", limit_ms: float = 100.0) -> RigConfig:
    # The machine's own disk and clock are not what these tests are about.
    limits = f"{{latency_p99_ms: {limit_ms}, least_modulation: null, least_disk_free_gb: null, clock_offset_ms: null}}"
    return parse_rig(f"cameras: {{driver: sim}}\nhealth: {{raise_s: 3.0, {more}, limits: {limits}}}\n")


def rig(**changes: Any) -> Rig:
    """The parts of a rig that health uses."""
    known = calibration()
    pattern = ColorFringe(size=known.projector.size, periods=60)
    made = Rig({}, None, known, pattern, Volume(1200, 1500), b"created: 2026-01-01\n", "sha256:0", lambda: None)  # type: ignore[arg-type]
    return replace(made, **changes)


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def watch(tmp_path: Path, clock: Clock) -> Iterator[Health]:
    made = Health(rig_yaml("metrics_port: 0"), rig(), tmp_path, clock=clock)
    yield made
    made.close()


def seconds(
    watch: Health, clock: Clock, count: int, *, latency_ms: float = 30.0, lit: Any = (50, 50), **values: Any
) -> None:
    """Feed seconds, each evaluated before the next begins; ``lit``: modulation of both cameras."""
    for _ in range(count):
        clock.move(1.0)
        seq = clock.now_ns // 1_000_000_000
        assert watch.offer(pair(seq, clock.realtime_ns()))
        item = cloud(seq, clock.realtime_ns(), latency_ms=latency_ms, ms={"decode": 3.0})
        modulation = tuple(np.full((SIZE[1], SIZE[0]), side, np.uint8) for side in lit)
        assert watch.offer(replace(item, cloud=replace(item.cloud, modulation=modulation)))
        before = watch.monitor.history.rows[0]
        watch.note_status(status(t_ns=clock.realtime_ns(), **values))
        wait_until(lambda before=before: watch.monitor.history.rows[0] == before + 1)


def test_it_evaluates_what_it_is_offered_and_summarises(watch: Health, clock: Clock) -> None:
    seconds(watch, clock, 5)
    wait_until(lambda: watch.status()["verdict"] == "healthy")
    seconds(watch, clock, 10, latency_ms=400.0)
    wait_until(lambda: watch.status()["verdict"] == "ill")
    summary = watch.status()
    assert summary["open"] == {"latency_p99_ms": "latency 400 ms, more than 100 ms"} and "problem" not in summary
    json.dumps(summary)


def test_the_illumination_of_a_pair_is_examined(watch: Health, clock: Clock) -> None:
    bright = np.full((48, 64, 3), 255, np.uint8)
    item = cloud(1, clock.realtime_ns())
    item = replace(item, left=frame("left", 1, clock.realtime_ns(), bright))
    clock.move(1.0)
    watch.offer(item)
    wait_until(lambda: watch.report()["look"]["count"] == 1)
    clock.move(1.0)
    watch.note_status(status(t_ns=clock.realtime_ns()))
    wait_until(lambda: watch.monitor.values["saturated_left_red"] == 1.0)
    assert watch.monitor.values["saturated_right"] == 0.0 and watch.monitor.values["coverage_lit"] == 1.0


def test_a_pair_without_fringes_makes_the_daemon_ill_until_they_are_back(watch: Health, clock: Clock) -> None:
    seconds(watch, clock, 5)
    assert watch.monitor.values["lit_share_left"] == 1.0
    seconds(watch, clock, 10, lit=(50, 0))
    wait_until(lambda: watch.status()["verdict"] == "ill")
    assert watch.status()["open"] == {
        "least_lit_share": "no fringes (0 % of the image): projector, lens cap, exposure (right camera)"
    }
    seconds(watch, clock, 16)
    wait_until(lambda: watch.status()["verdict"] == "healthy")


def test_one_small_object_is_light_enough(watch: Health, clock: Clock) -> None:
    few = np.zeros((SIZE[1], SIZE[0]), np.uint8)
    few[8:12, 20:24] = 50
    seconds(watch, clock, 12, lit=(few, few))
    assert watch.status()["verdict"] == "healthy"
    assert watch.monitor.values["lit_share_right"] == pytest.approx(16 / few.size)


def test_images_that_cannot_be_examined_are_reported_and_the_seconds_go_on(watch: Health, clock: Clock) -> None:
    item = cloud(1, clock.realtime_ns())
    clock.move(1.0)
    watch.offer(replace(item, left=replace(item.left, image=np.zeros(3, np.uint8))))
    wait_until(lambda: "light" in watch.status().get("failed", ""))
    seconds(watch, clock, 3)
    assert watch.monitor.history.rows[0] == 3


def test_the_methods_respond_and_refuse(watch: Health, clock: Clock) -> None:
    seconds(watch, clock, 20)
    table = HealthMethods(watch).table()
    report = json.loads(json.dumps(table["health"]({})))
    assert report["verdict"] == "healthy" and report["values"]["cloud_rate_hz"] == 10.0
    wait_until(lambda: watch._disk.value() is not None)
    course = table["health.history"]({"quantities": ["latency_p99_ms", "disk_free_gb"], "seconds": 20, "points": 10})
    assert len(course["t_s"]) == 10 and course["series"]["latency_p99_ms"]["mean"][-1] == 30.0
    assert course["t_s"][-1] == pytest.approx(clock.realtime_ns() / 1e9, abs=2.0)
    assert table["health.events"]({"most": 5}) == []
    wrong: list[dict[str, Any]] = [
        {}, {"quantities": []}, {"quantities": ["nothing"]}, {"quantities": [1]}, {"quantities": [NAMES[0]] * 9},
        {"quantities": [NAMES[0]], "seconds": 1e9}, {"quantities": [NAMES[0]], "points": True},
    ]  # fmt: skip
    for params in wrong:
        with pytest.raises(RpcError):
            table["health.history"](params)
    with pytest.raises(RpcError, match="expected a number from 1 to 1000"):
        table["health.events"]({"most": "x"})


def test_the_metrics_are_served(watch: Health, clock: Clock) -> None:
    seconds(watch, clock, 3)
    with urllib.request.urlopen(watch.status()["metrics"], timeout=30) as answer:
        text = answer.read().decode()
    assert 'fringed_health{verdict="healthy"} 1' in text
    for line in text.splitlines():
        assert line.startswith("# ") or float(line.rsplit(" ", 1)[1]) is not None


def test_the_images_are_drawn_from_the_methods_results(watch: Health, clock: Clock) -> None:
    import xml.etree.ElementTree as ET

    import cv2

    seconds(watch, clock, 15)
    seconds(watch, clock, 15, latency_ms=300.0)
    table = HealthMethods(watch).table()
    shown = panels.request_history(lambda name, /, **params: json.loads(json.dumps(table[name](params))), 60.0)
    assert "Latency" in [panel.title for panel in shown.panels()]
    html = page.html(shown).decode()
    ET.fromstring(html.split("\n", 1)[1])
    assert "latency 300 ms, more than 100 ms" in html and "nan" not in html
    image = cv2.imdecode(np.frombuffer(page.png(shown), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and image.shape[1] == 2 * 1160 and len(np.unique(image)) > 50


def test_without_fonts_the_image_is_drawn_with_strokes(
    watch: Health, clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    import cv2

    monkeypatch.delattr(cv2, "FontFace", raising=False)
    seconds(watch, clock, 12)
    table = HealthMethods(watch).table()
    shown = panels.request_history(lambda name, /, **params: table[name](params), 60.0)
    image = cv2.imdecode(np.frombuffer(page.png(shown), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None and (image[:100] < 128).any()


def test_images_of_a_daemon_that_has_just_begun(watch: Health) -> None:
    table = HealthMethods(watch).table()
    shown = panels.request_history(lambda name, /, **params: table[name](params), 600.0)
    assert not shown.panels() and b"no data in this time" in page.html(shown) and page.png(shown)


def test_other_limits_and_another_calibration_are_applied_at_once(watch: Health, clock: Clock) -> None:
    seconds(watch, clock, 5)
    now = watch.change(rig_yaml(limit_ms=10.0), rig())
    seconds(watch, clock, 5)
    wait_until(lambda: watch.status()["verdict"] == "healthy")
    now()
    seconds(watch, clock, 10)
    wait_until(lambda: watch.status()["verdict"] == "ill")


def test_a_calibration_from_a_file_has_an_age(watch: Health, clock: Clock) -> None:
    config = rig_yaml()
    watch.change(config.model_copy(update={"calibration": "calibration.yaml"}), rig())()
    clock.now_ns += int(datetime(2026, 4, 11, tzinfo=UTC).timestamp() * 1e9) - clock.realtime_ns()
    seconds(watch, clock, 5)
    assert watch.monitor.values["calibration_age_d"] == pytest.approx(100, abs=0.01)
    wait_until(lambda: "calibration_age_d" in watch.status()["open"])
    watch.change(config, rig())()
    seconds(watch, clock, 1)
    assert np.isnan(watch.monitor.values["calibration_age_d"])


def test_it_ends_while_it_is_busy_and_takes_nothing_afterwards(tmp_path: Path) -> None:
    made = Health(rig_yaml(), rig(), tmp_path)
    for n in range(50):
        made.offer(cloud(n, 0))
        made.note_status(status())
    made.close()
    assert made.offer(cloud(51, 0)) and made.status()["verdict"] in ("healthy", "unknown")
