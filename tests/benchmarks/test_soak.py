"""The soak run: what counts as lost, what as growth, and a short run of everything together."""

from __future__ import annotations

import copy
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from benchmarks.common.process_statistics import Sample, sample
from benchmarks.soak import report
from tools.waiting import wait_until

STATUS: dict[str, Any] = {
    "pairs": 100,
    "clouds": 90,
    "drops": {"pairs_not_ready": 10},
    "cameras": {side: {"fates": {"paired": 100, "waiting": 1, "before_sync": 2}} for side in ("left", "right")},
    "recorder": {"dropped": {}},
    "sinks": {"stream": {"dropped": 0}},
}
GOOD: dict[str, Any] = {
    "losses": {},
    "memory": {"early_mib": 300.0, "late_mib": 301.0},
    "pairs": 900,
    "rate_hz": 30.0,
    "seconds": 30.0,
    "problems": [],
    "exit_status": 0,
}


def later(**changes: int) -> dict[str, Any]:
    """The status after further pairs, of which some were dropped for these reasons."""
    status = copy.deepcopy(STATUS)
    status["pairs"] += 50
    status["clouds"] += 50 - sum(changes.values())
    status["drops"] |= changes
    return status


def samples(own_mib: list[float]) -> list[Sample]:
    return [Sample(float(t_s), mib + 100, mib, 10, 20, {}) for t_s, mib in enumerate(own_mib)]


def test_losses_before_the_run_do_not_count() -> None:
    assert report.losses(STATUS, later(), {"cloud/full": 0}) == {}


def test_dropped_pairs_are_counted_once_although_every_reader_misses_them() -> None:
    lost = report.losses(STATUS, later(pairs_pipeline_busy=4), {"cloud/full": 4, "cloud/depth": 6})
    assert lost == {"pairs_pipeline_busy": 4, "cloud/depth_not_received": 2}


def test_pairs_missing_without_a_reason_are_counted() -> None:
    status = later()
    status["clouds"] -= 7
    assert report.losses(STATUS, status, {})["pairs_unaccounted"] > 0


def test_losses_of_frames_recorder_and_stream_are_reported() -> None:
    status = later()
    status["cameras"]["right"]["fates"]["partner_missing"] = 3
    status["recorder"]["dropped"] = {"queue_full": 5}
    status["sinks"]["stream"]["dropped"] = 2
    lost = report.losses(STATUS, status, {"cloud/full": 2})
    assert lost == {"frames_right_partner_missing": 3, "recorder_queue_full": 5, "stream_overtaken": 2}


def test_growth_compares_an_early_part_with_the_end() -> None:
    rising = report.growth(samples([100.0 + t_s for t_s in range(1000)]))
    assert rising["late_mib"] - rising["early_mib"] == pytest.approx(600, abs=2)
    assert rising["slope_mib_per_hour"] == pytest.approx(3600, rel=1e-3)
    steady = report.growth(samples([0.0] * 100 + [300.0, 320.0] * 450))
    assert steady["late_mib"] == steady["early_mib"] == 310


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"losses": {"pairs_pipeline_busy": 1}}, "pairs_pipeline_busy 1"),
        ({"memory": {"early_mib": 300.0, "late_mib": 400.0}}, "memory grew"),
        ({"pairs": 800}, "800 pairs came"),
        ({"problems": ["camera left is gone"]}, "camera left"),
        ({"exit_status": -11}, "exit status -11"),
    ],
)
def test_every_fault_is_reported(change: dict[str, Any], message: str) -> None:
    assert report.verdict(GOOD) == []
    (fault,) = report.verdict(GOOD | change)
    assert message in fault


def test_processor_time_is_that_of_the_run_by_thread() -> None:
    first = Sample(0.0, 1.0, 1.0, 2, 3, {"pipeline": 10.0, "stream": 1.0})
    last = Sample(9.0, 1.0, 1.0, 2, 3, {"pipeline": 12.0, "stream": 1.0, "recorder": 0.5})
    assert report.cpu_ms_per_pair([first, last], 100) == {"pipeline": 20.0, "recorder": 5.0}


GROWING = """
import os, threading
print(flush=True)
input()
kept = bytearray(os.urandom(1 << 20) * 64)
stop = threading.Event()
thread = threading.Thread(target=stop.wait)
thread.start()
print(flush=True)
input()
stop.set()
thread.join()
print(flush=True)
input()
"""


def test_a_sample_agrees_with_the_process() -> None:
    """Of a process of its own: threads that other tests have left would end here at any time."""
    samples = []
    with subprocess.Popen([sys.executable, "-c", GROWING], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdin is not None and process.stdout is not None
        for k in range(3):
            assert process.stdout.readline()
            if k == 2:  # the thread was joined; the system removes it a little later
                wait_until(lambda: sample(process.pid, 2.0).threads == samples[0].threads)
            samples.append(sample(process.pid, float(k)))
            process.stdin.write(b"\n")
            process.stdin.flush()
    before, after, _ = samples
    assert after.own_mib - before.own_mib > 50
    assert after.threads == before.threads + 1 and after.rss_mib >= after.own_mib
    assert sum(after.cpu_s.values()) >= sum(before.cpu_s.values())


@pytest.mark.timeout(400)  # the first run on a machine compiles every kernel
def test_a_short_run_gives_every_figure_and_leaves_nothing_behind(tmp_path: Path) -> None:
    takes = tmp_path / "takes"
    takes.mkdir()
    command = [sys.executable, "-m", "benchmarks.soak", "--minutes", "0.05", "--rate", "4", "--settle", "0.5"]
    command += ["--scale", "0.125", "--frames", "2", "--scene", "plane", "--dir", str(takes), "--out", str(tmp_path)]
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    process = subprocess.run(command, capture_output=True, text=True, timeout=380, check=False, env=environment)
    result = json.loads((tmp_path / "soak.json").read_text())
    # A slow machine may lose pairs: the exit code must report that, and nothing else may fail.
    assert process.returncode == (1 if result["faults"] else 0), process.stdout + process.stderr
    assert result["exit_status"] == 0 and result["pairs"] > 0 and result["received"]["cloud/full"] > 0
    assert result["page_faults"]["pair_p50"] < 200  # each pair uses memory of an earlier one; few pairs are measured
    assert result["recorded_pairs"] > 0 and result["problems"] == [] and "pipeline" in result["cpu_ms_per_pair"]
    assert {"p50", "p99", "p999", "max"} <= set(result["latency_ms"]["frames here .. cloud published"])
    assert list(takes.iterdir()) == []
