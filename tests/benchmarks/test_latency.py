"""The latency benchmark: tables, limits, and a short run with readers in processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections import Counter
from pathlib import Path

import pytest

from benchmarks.latency import LOADS, Rounds, faults, tables


def rounds(p99: float) -> Rounds:
    cpu_s, drops = Counter(pipeline=5.4, stream=0.54), Counter(pairs_pipeline_busy=12, clouds_slow_busy=5)
    return Rounds([p99 / 2] * 90 + [p99] * 10, [p99 / 2] * 100, 10.0, 120, 108, 12.0, cpu_s, drops)


def test_tables_have_a_row_for_each_load() -> None:
    latency, cpu = tables({(1.0, 10.0): (rounds(40.0), rounds(60.0))})
    assert [row[2] for row in latency.rows] == [row[2] for row in cpu.rows] == list(LOADS)
    alone = dict(zip(latency.headings, latency.rows[0], strict=True))
    assert alone["clouds a second"] == "10.0" and alone["p50"] == "20.0" and alone["P99 to alone"] == "1.00"
    assert alone["pairs dropped %"] == "10.0"  # clouds that a sink lost are no pairs
    assert dict(zip(latency.headings, latency.rows[1], strict=True))["P99 to alone"] == "1.50"
    thread = dict(zip(cpu.headings, cpu.rows[0], strict=True))
    assert thread["pipeline"] == "50.0" and thread["stream"] == "5.0" and thread["all"] == "55.0"


@pytest.mark.parametrize(("loaded", "count"), [(rounds(43.0), 0), (rounds(45.0), 1), (Rounds(), 1)])
def test_more_than_a_tenth_and_no_cloud_at_all_are_faults(loaded: Rounds, count: int) -> None:
    assert len(faults({(1.0, 10.0): (rounds(40.0), loaded)})) == count


@pytest.mark.timeout(400)  # the first run on a machine compiles every kernel
@pytest.mark.long
def test_a_short_run_measures_in_another_process_alone_and_under_load(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "benchmarks.latency", "--rates", "8", "--scales", "0.125", "--seconds", "1.5"]
    command += ["--rounds", "1", "--frames", "2", "--out", str(tmp_path)]
    environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path / "cache"), "TMPDIR": str(tmp_path)}
    process = subprocess.run(command, capture_output=True, text=True, timeout=380, check=False, env=environment)
    alone, loaded = json.loads((tmp_path / "latency.json").read_text())
    # A slow machine may be late, which the exit code reports.
    assert process.returncode in (0, 1) and "P99" in process.stdout, process.stdout + process.stderr
    for one in (alone, loaded):
        assert min(one["received"], one["pairs"], one["clouds"]) > 3 and one["cpu_ms"]["pipeline"] > 0
        assert one["received_ms"]["p50"] >= one["finished_ms"]["p50"] > 0
    assert alone["recorded"] == 0 and loaded["recorded"] > 3
    assert not list(tmp_path.glob("latency-*"))
