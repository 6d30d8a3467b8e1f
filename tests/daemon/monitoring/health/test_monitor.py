"""The evaluation once a second: events, idle states, and reports in plain JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest

from daemon.apps.health_report.text import report_text
from daemon.monitoring.health.events import KEPT
from daemon.monitoring.health.monitor import Monitor
from daemon.monitoring.health.observe.clock_sync import ClockSync
from daemon.monitoring.health.prometheus.exposition import exposition
from daemon.monitoring.health.quantities import NAMES, TABLE, format_value
from daemon.monitoring.health.rules import RULES
from tests.daemon.monitoring.health.samples import camera, cloud, config, pair, status

S = 1_000_000_000


class Course:
    """A monitor, fed second by second."""

    def __init__(self, **values: Any) -> None:
        self.monitor = Monitor(config(raise_s=3.0, clear_s=5.0, **values))
        self.now_ns, self.seq = 0, 0

    def run(self, seconds: int, *, latency_ms: float = 30.0, clock: ClockSync | None = None, **values: Any) -> None:
        """Ten pairs and clouds a second."""
        machine = values.pop("machine", {})
        flowing = values.get("state", "running") == "running"
        for _ in range(seconds):
            self.now_ns += S
            for _ in range(10 if flowing else 0):
                self.seq += 1
                t_ns = self.seq * S // 10
                self.monitor.frames.pair(pair(self.seq, t_ns, residual_ns=20_000), self.now_ns)
                self.monitor.frames.cloud(cloud(self.seq, t_ns, latency_ms=latency_ms, ms={"decode": 4.0}), self.now_ns)
            self.monitor.second(self.now_ns, status(pairs=self.seq, clouds=self.seq, **values), machine, clock)

    @property
    def ends(self) -> list[tuple[str, str]]:
        return [(event.rule, event.end) for event in self.monitor.rules.events()]


def test_a_rig_that_measures_is_healthy_and_one_that_has_not_begun_is_unknown() -> None:
    course = Course()
    assert course.monitor.verdict == "unknown"
    course.run(5, state="starting")
    assert course.monitor.verdict == "unknown"
    course.run(30)
    assert course.monitor.verdict == "healthy" and course.ends == []
    course.run(30, state="paused", reasons=("calibrating",))
    assert course.monitor.verdict == "unknown" and course.ends == []


def test_high_latency_is_raised_and_cleared() -> None:
    course = Course(limits={"latency_p99_ms": 100.0})
    course.run(10)
    course.run(10, latency_ms=250.0)
    assert course.monitor.verdict == "ill"
    assert course.monitor.short()["open"] == {"latency_p99_ms": "latency 250 ms, more than 100 ms"}
    course.run(30)
    assert course.monitor.verdict == "healthy" and course.ends == [("latency_p99_ms", "cleared")]
    (event,) = course.monitor.rules.events()
    assert event.worst == 250.0 and event.limit == 100.0


def test_one_slow_cloud_is_not_raised() -> None:
    course = Course(limits={"latency_p99_ms": 100.0}, window_s=2)
    for _ in range(5):
        course.run(1, latency_ms=400.0)
        course.run(9)
    assert course.ends == []


def test_a_lost_camera_makes_it_ill_with_its_own_message() -> None:
    course = Course()
    course.run(10, state="degraded", reasons=("camera left is gone: no answer",))
    assert course.monitor.rules.open[0].text == "camera left is gone: no answer"
    course.run(20)
    assert course.monitor.verdict == "healthy"


def test_ill_events_come_before_warnings() -> None:
    course = Course(limits={"latency_p99_ms": 10.0})
    warm = {"left": camera(temperature_c=40.0), "right": camera(temperature_c=81.0)}
    course.run(10, latency_ms=5.0, cameras=warm, machine={"disk_free_gb": 1.0})
    assert course.monitor.verdict == "warning"
    course.run(10, latency_ms=50.0, cameras=warm, machine={"disk_free_gb": 1.0})
    opened = course.monitor.rules.open
    assert [event.rule for event in opened] == ["latency_p99_ms", "temperature_c", "least_disk_free_gb"]
    assert opened[1].text == "81 °C, more than 70 °C (right camera)"


def test_both_cameras_are_named_where_both_break_a_limit() -> None:
    course = Course()
    warm = {"left": camera(temperature_c=75.0), "right": camera(temperature_c=81.0)}
    course.run(10, cameras=warm)
    assert course.monitor.rules.open[0].text == "81 °C, more than 70 °C (left and right cameras)"


@pytest.mark.parametrize(
    ("clock", "ill"),
    [
        (None, []),
        (ClockSync("chrony", True, 0.4), []),
        (ClockSync("chrony", True, -40.0), ["clock_offset_ms"]),
        (ClockSync("kernel", False), ["clock_synchronised"]),
    ],
)
def test_an_unknown_clock_raises_no_event(clock: ClockSync | None, ill: list[str]) -> None:
    course = Course(limits={"clock_synchronised": True})
    course.run(10, clock=clock)
    assert [event.rule for event in course.monitor.rules.open] == ill


def test_other_limits_hold_from_the_next_second_on() -> None:
    course = Course()
    course.run(10)
    course.monitor.configure(config(raise_s=3.0, limits={"latency_p99_ms": 10.0}))
    course.run(10)
    assert course.monitor.verdict == "ill"
    course.monitor.configure(config(limits={"latency_p99_ms": None}))
    course.run(1)
    assert course.monitor.verdict == "healthy" and course.ends == [("latency_p99_ms", "not judged")]


def test_the_reports_are_plain_and_bounded() -> None:
    course = Course(limits={"latency_p99_ms": 10.0})
    course.run(20, drops={"pairs_not_ready": 3}, clock=ClockSync("chrony", True, 0.4))
    report = json.loads(json.dumps(course.monitor.report(course.now_ns)))
    assert set(report["values"]) == set(NAMES) and report["windows"]["10s"]["stages_ms"]["decode"]["p50"] == 4.0
    assert len(json.dumps(course.monitor.short())) < 900
    text = report_text(report, [event.as_dict() for event in course.monitor.rules.events()])
    assert "ILL" in text and max(len(line) for line in text.splitlines()) <= 80
    page = exposition(report)
    assert (
        'fringed_health{verdict="ill"} 1.0\n' in page and 'fringed_drops_total{reason="pairs_not_ready"} 3.0\n' in page
    )
    assert " nan" not in page.lower()


def test_events_are_bounded() -> None:
    course = Course()
    course.monitor.configure(config(raise_s=0.0, clear_s=0.0, limits={"latency_p99_ms": 100.0}))
    rules = course.monitor.rules
    values = dict.fromkeys(NAMES, float("nan"))
    for n in range(2 * KEPT + 20):
        rules.feed(float(n), n, values | {"latency_p99_ms": 500.0 if n % 2 else 10.0})
    assert rules.count == KEPT + 10 and len(rules.events(5 * KEPT)) == KEPT + 1  # one of them lasts
    assert rules.events(3)[-1].number == rules.count


def test_every_rule_has_its_limit_and_its_quantities() -> None:
    limits = config().limits
    for rule in RULES:
        rule.limit(limits)
        assert set(rule.quantities) <= set(NAMES), rule.name
        assert rule.text(dict.fromkeys(rule.quantities, 1.0), 2.0)
    assert {rule.name for rule in RULES} == set(type(limits).model_fields) | {"degraded"}
    assert len(NAMES) == len(TABLE) and format_value("dropped_share", 0.25) == "25 %"
