"""The demo's rig file, viewer and status lines."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from daemon.cli.control.status_rows import drop_rows
from daemon.cli.measure import demo, demo_processes
from daemon.config import load_rig
from daemon.control.rpc.server import ControlServer
from fringed.control.address import control_endpoint
from tools.waiting import wait_until

STATUS: dict[str, Any] = {
    "state": "running",
    "cloud_rate_hz": 4.5,
    "pair_rate_hz": 5.0,
    "points": 1000,
    "latency_ms": {"p50": 100.2, "p95": 200.0},
    "drops": {"pairs_pipeline_busy": 2},
}


@pytest.mark.parametrize("small", [True, False])
def test_the_demo_writes_a_valid_rig_file(tmp_path: Path, small: bool) -> None:
    path, endpoint, _ = demo.write_rig(tmp_path, demo.options("moving", None, 3, 2.0, small=small))
    config = load_rig(path)
    assert endpoint in config.stream.endpoints and config.simulation["frames"] == 3


def test_the_demo_is_found_where_commands_expect_a_daemon(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    path, _, control = demo.write_rig(tmp_path, demo.options("moving", None, 3, 2.0, small=True))
    assert control == control_endpoint() == load_rig(path).control.endpoint
    server = ControlServer(control, {})  # now another daemon has it
    try:
        path, _, other = demo.write_rig(tmp_path, demo.options("moving", None, 3, 2.0, small=True))
    finally:
        server.start()
        server.close()
    assert other == f"ipc://{tmp_path}/control" == load_rig(path).control.endpoint


def test_what_was_dropped_while_starting_is_counted_apart() -> None:
    drops = {"pairs_not_ready": 40, "pairs_pipeline_busy": 2}
    status = STATUS | {"drops": drops, "drops_starting": {"pairs_not_ready": 39}}
    assert demo_processes.line(status).endswith("dropped 3 (39 while starting)")
    rows = dict(drop_rows(status))
    assert rows == {"dropped": {"pairs_not_ready": 1, "pairs_pipeline_busy": 2}, "at start": {"pairs_not_ready": 39}}


def test_the_line_contains_rate_points_and_latency() -> None:
    text = demo_processes.line(STATUS)
    assert all(part in text for part in ("4.5 clouds/s", "1000 points", "latency 100 ms", "dropped 2"))
    assert "no cloud yet" in demo_processes.line(STATUS | {"latency_ms": {}})


def test_the_demo_ends_after_its_seconds_of_measuring() -> None:
    now_s, lines, stopped = [0.0], [], []
    report = demo_processes.Report(
        2.0, stop=lambda: stopped.append(True), viewer=None, echo=lines.append, now_s=lambda: now_s[0]
    )
    for second in (50.0, 51.0, 52.0):
        now_s[0] = second
        report(STATUS | {"state": "starting"} if second == 0 else STATUS)
    assert len(lines) == 3 and stopped == [True]


def test_a_viewer_that_ends_is_reported_once_and_measuring_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_processes, "_VIEW", "raise SystemExit(7)")
    lines: list[str] = []
    viewer = demo_processes.Viewer("ipc://nowhere")
    report = demo_processes.Report(None, stop=lambda: None, viewer=viewer, echo=lines.append, now_s=lambda: 0.0)
    report(STATUS)
    assert viewer._process is not None
    wait_until(lambda: viewer._process is not None and viewer._process.poll() is not None)
    report(STATUS)
    report(STATUS)
    assert [text for text in lines if "viewer" in text] == ["the viewer ended (exit status 7); measuring continues"]


def test_a_viewer_that_hangs_is_ended_with_the_demo(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(demo_processes, "_VIEW", "import time; time.sleep(1000)")
    viewer = demo_processes.Viewer("ipc://nowhere")
    viewer.start()
    process = viewer._process
    viewer.close()
    assert process is not None and process.returncode is not None and sys.executable in process.args
