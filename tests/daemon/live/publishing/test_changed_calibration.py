"""Another calibration while the stream runs: every cloud names its calibration, and the meta data come first."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import zmq

from daemon.rig.open_rig import Rig
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.volume import Volume
from tests.daemon import rigs
from tests.daemon.live.publishing import clouds
from tools.waiting import wait_until

OLD, NEW = "sha256:00", "sha256:11"


def other_rig() -> Rig:
    made = clouds.calibration()
    pattern = ColorFringe(size=made.projector.size, periods=10)
    return Rig({}, None, made, pattern, Volume(1200, 1500), b"again: 1\n", NEW, lambda: None)  # type: ignore[arg-type]


def test_the_meta_data_come_before_the_first_cloud_of_the_new_calibration(tmp_path: Path) -> None:
    with clouds.publisher() as made, zmq.Context() as context, context.socket(zmq.SUB) as reader:
        reader.setsockopt(zmq.LINGER, 0)
        reader.connect(made.endpoints[0])
        for topic in (b"meta/", b"cloud/full"):
            reader.setsockopt(zmq.SUBSCRIBE, topic)
        wait_until(lambda: made.has_subscribers("cloud/full") and made.has_subscribers("meta/rays"), 30)
        got: list[tuple[str, dict[str, Any], list[bytes]]] = []

        def receive(until: str, times: int, identity: str = "") -> None:
            while sum(t == until and identity in ("", header["calibration"]) for t, header, _ in got) < times:
                assert reader.poll(30_000), "nothing came"
                topic, header, *parts = reader.recv_multipart()
                got.append((topic.decode(), json.loads(header), parts))

        # Each burst is awaited: the next message would not fit into the publisher's queue beside it.
        for topic in ("meta/calibration", "meta/config", "meta/rays"):
            receive(topic, 1)
        made.offer(clouds.item(1))
        receive("cloud/full", 1)
        commit = made.change(rigs.config(tmp_path), other_rig())
        made.offer(clouds.item(2))
        receive("cloud/full", 2)
        with made._lock:  # both before the thread of the stream comes to it
            made.offer(clouds.item(3))
            commit()
        receive("cloud/full", 3)
        for topic in ("meta/calibration", "meta/config", "meta/rays"):
            receive(topic, 1, NEW)
        commit()
        made.offer(clouds.item(4))
        receive("cloud/full", 4)
    seen = [(header["seq"], header["calibration"]) for topic, header, _ in got if topic == "cloud/full"]
    assert seen == [(1, OLD), (2, OLD), (3, OLD), (4, NEW)]
    topics = [(topic, header["calibration"]) for topic, header, _ in got]
    for topic in ("meta/calibration", "meta/rays", "meta/config"):
        assert topics.index((topic, NEW)) < topics.index(("cloud/full", NEW))
    retained = {
        bytes(parts[0]) for topic, header, parts in got if topic == "meta/calibration" and header["calibration"] == NEW
    }
    assert retained == {b"again: 1\n"}
