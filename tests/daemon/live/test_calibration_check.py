"""A running daemon publishes no point of a pair that contradicts the calibration, gives the reason, and recovers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from daemon.live.publishing import messages
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.consistency import Consistency
from tests.daemon.monitoring.calibration_drift.test_running_daemon import LIVE, running, trigger_until


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_turned_camera_is_reported_at_once_and_its_clouds_hold_no_point(tmp_path: Path):
    with running(tmp_path, LIVE | {"scene": "mixed", "layout": {"scale": 0.5}}) as (made, service, trigger):
        trigger()
        status = service.status()
        assert status.calibration_check["verdict"] == "consistent", status.calibration_check
        assert status.calibration_check["policy"] == "withhold"
        assert status.points > 20_000
        made.trigger.disturb("right", turn_deg=(0.1, 0.0, 0.0))
        assert trigger_until(service, trigger, lambda s: s["calibration_check"]["verdict"] == "inconsistent") <= 2
        status = service.status()
        assert status.points == 0
        assert status.calibration_check["withheld"] >= 1
        assert str(status.state) == "degraded"
        [reason] = [reason for reason in status.reasons if "contradict the calibration" in reason]
        assert "turned about its horizontal axis by 0.1" in reason
        assert np.isnan(service.worker.last.cloud.xyz).all()
        made.trigger.disturb("right", turn_deg=(-0.1, 0.0, 0.0))
        trigger_until(service, trigger, lambda s: s["calibration_check"]["verdict"] == "consistent")
        assert service.status().points > 20_000


def test_the_header_carries_the_verdict_and_the_reason_of_a_refusal(cloud_item, origin):
    plain = messages.full(origin, cloud_item(None))[1]
    assert b'"calibration":"consistent"' not in bytes(plain)
    good = bytes(messages.full(origin, cloud_item(Consistency("consistent")))[1])
    assert b'"calibration":"consistent"' in good
    assert b"reason" not in good
    bad = Consistency("inconsistent", {}, ("column_offset +0.05",) * 200, "the right camera is turned")
    header = bytes(messages.full(origin, cloud_item(bad))[1])
    assert b'"calibration":"inconsistent"' in header
    assert b"the right camera is turned" in header
    assert len(header) < 4096


@pytest.fixture
def origin() -> messages.Origin:
    return messages.Origin("rig", "session", "sha256:0")


@pytest.fixture
def cloud_item():
    from daemon.live.items import CloudItem
    from drivers.protocols import Frame

    image = np.zeros((4, 6, 3), np.uint8)
    frames = [Frame(side, 1, 1, 1, "rgb8", image) for side in ("left", "right")]

    def make(found: Consistency | None) -> CloudItem:
        plane = np.zeros((4, 6), np.uint8)
        cloud = Cloud(
            np.full((4, 6, 3), np.nan, np.float32), np.full((4, 6), np.nan, np.float32), plane, (plane, plane),
            np.full((4, 6), -1, np.int16), consistency=found,
        )  # fmt: skip
        return CloudItem(1, 1, cloud, *frames, 1.0, 0)

    return make
