"""The self-check takes other limits and another calibration over while it runs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, cast

from daemon.config import RigConfig
from daemon.monitoring.calibration_drift.sink import DriftMonitor
from daemon.monitoring.calibration_drift.verdicts import limits_of
from tests.daemon.monitoring.calibration_drift.test_running_daemon import running
from tests.daemon.rigs import config
from tools.waiting import wait_until

PLANE: dict[str, Any] = {"scene": "plane", "frames": 2, "rate_hz": 0.0, "layout": {"scale": 0.125}}


def with_limit(tmp_path: Path) -> RigConfig:
    return config(tmp_path, "selfcheck: {rate_hz: 20.0, limits: {column_px: 0.5}}\n")


def test_other_limits_hold_from_the_next_check_on(tmp_path: Path) -> None:
    with running(tmp_path, PLANE) as (_, service, trigger):
        check, fresh = cast(DriftMonitor, service.router.sinks["selfcheck"]), with_limit(tmp_path)
        assessor = check._assessor
        service.change(fresh, service.rig, service.settings, [check.change(fresh, service.rig)])
        wait_until(lambda: check._pending is None)
        trigger()
        assert check._assessor is assessor  # what was learned stays
        assert {name: one.limit for name, one in assessor._series.items()} == limits_of(fresh.selfcheck.limits)


def test_another_calibration_begins_a_reference_of_its_own(tmp_path: Path) -> None:
    with running(tmp_path, PLANE) as (_, service, trigger):
        check, rig = cast(DriftMonitor, service.router.sinks["selfcheck"]), replace(service.rig, identity="sha256:11")
        assessor = check._assessor
        service.change(service.config, rig, service.settings, [check.change(service.config, rig)])
        wait_until(lambda: check._pending is None)
        for _ in range(8):
            trigger()
        assert check._assessor is not assessor and check._identity == "sha256:11" == service.status().calibration
