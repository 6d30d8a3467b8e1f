"""Publisher and subscriber over real sockets."""

from __future__ import annotations

import asyncio
import itertools
import json
import logging
import socket
import stat
import threading
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
import zmq

from daemon.bootstrap.sinks import open_publisher
from daemon.common.errors import DaemonError
from daemon.live.items import UnpairedFrame
from daemon.live.publishing.preview import overlay
from daemon.live.publishing.publisher import Publisher
from fringed import FringedError, SilenceError, WireError, asubscribe, subscribe, wire
from fringed.stream.losses import Losses
from fringed.stream.receiver import Receiver
from fringed.stream.subscription import Subscription
from tests.daemon import rigs
from tests.daemon.live.publishing import clouds
from tests.open_files import open_files
from tools.waiting import wait_until

WAIT_S = 8.0


def connected(made: Publisher, topic: str = "cloud/full") -> None:
    wait_until(lambda: made.has_subscribers(topic))


def message(receiver: Receiver) -> wire.Message:
    received = receiver.receive(WAIT_S)
    assert received is not None
    return received


@pytest.mark.parametrize("kind", ["tcp", "ipc"])
def test_a_cloud_arrives_bit_for_bit(kind: str, tmp_path: Path) -> None:
    endpoint = clouds.TCP if kind == "tcp" else f"ipc://{tmp_path}/run/stream"
    with clouds.publisher(endpoint) as made, subscribe(made.endpoints[0], timeout_s=WAIT_S) as stream:
        connected(made)
        item = clouds.item(17)
        made.offer(item)
        cloud = next(stream)
    assert (cloud.header.seq, cloud.header.t_ns, cloud.header.device) == (17, item.t_ns, "rig-t")
    np.testing.assert_array_equal(cloud.xyz, item.cloud.xyz)
    np.testing.assert_array_equal(cloud.gray, item.cloud.gray)
    np.testing.assert_array_equal(cloud.sigma, item.cloud.sigma_mm)
    assert cloud.points.shape == (item.cloud.points, 3)


def test_the_depth_topic_gives_the_same_points() -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], topic="cloud/depth", timeout_s=WAIT_S) as stream:
        connected(made, "cloud/depth")
        wait_until(lambda: clouds.sent(made, "meta/rays"))
        item = clouds.item(5)
        wait_until(lambda: made.offer(item) and _here(stream))
        cloud = next(stream)
    np.testing.assert_allclose(cloud.xyz, item.cloud.xyz, atol=0.004)
    assert cloud.gray is None and cloud.sigma is None


@pytest.mark.parametrize("topic", ["cloud/full", "cloud/depth"])
def test_half_clouds_state_their_stride_and_lie_on_every_second_ray(topic: str) -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], topic=topic, timeout_s=WAIT_S) as stream:
        connected(made, topic)
        item = clouds.half(5)
        if topic == "cloud/depth":
            wait_until(lambda: clouds.sent(made, "meta/rays"))
            wait_until(lambda: made.offer(item) and _here(stream))
        else:
            made.offer(item)
        cloud = next(stream)
    assert (cloud.every, cloud.header.width, cloud.header.height) == (2, 16, 13)
    np.testing.assert_allclose(cloud.xyz, item.cloud.xyz, atol=0.004)


def test_the_latency_of_publishing_begins_when_both_frames_are_here() -> None:
    clock = rigs.SteppedClock()
    with clouds.publisher(clock=clock) as made, Receiver(made.endpoints[0], ["cloud/full"]) as receiver:
        connected(made)
        assert made.status()["latency_ms"] == {}
        item = clouds.item(1)
        left = replace(item.left, t_host_ns=clock.now_ns - 9_000_000)
        right = replace(item.right, t_host_ns=clock.now_ns - 5_000_000)
        made.offer(replace(item, left=left, right=right))
        message(receiver)
        wait_until(lambda: made.status()["latency_ms"])
        assert made.status()["latency_ms"]["max"] == made.status()["latency_ms"]["p999"] == 5.0


def _wants(made: Publisher, stream: Subscription) -> bool:
    stream._clouds.poll(0)
    return made.has_subscribers(stream.topic)


def _here(stream: Subscription) -> bool:
    return stream._meta is not None and all(socket.poll(0) for socket in stream._sockets())


def test_late_joiners_get_the_meta_messages() -> None:
    with clouds.publisher() as made:
        for _ in range(2):
            with Receiver(made.endpoints[0], ["meta/"], queue=8) as receiver:
                came = {m.topic: m for m in (message(receiver) for _ in range(4))}
            assert bytes(came["meta/calibration"].arrays["calibration"]) == b"fringed_calibration: 1\n"
            rays = came["meta/rays"].arrays["rays"]
            np.testing.assert_allclose(rays, clouds.calibration().left.rays(), atol=1e-6)
            assert json.loads(bytes(came["meta/config"].arrays["config"])) == {"device": {"name": "rig-t"}}
            assert "CloudHeader" in bytes(came["meta/schema"].arrays["schema"]).decode()


@pytest.mark.parametrize("seed", range(8))
def test_a_subscriber_of_all_topics_loses_no_meta_message_whenever_it_joins(seed: int) -> None:
    """Clouds, previews, status and log go out all the time; it reads nothing until much more was sent than fits."""
    stop = threading.Event()

    def everything(made: Publisher) -> None:
        item = clouds.item(1, size=(1024, 820))
        for seq in itertools.count():
            if stop.wait(0.002):
                return
            made.offer(replace(item, seq=seq))
            made.publish_status({"t_ns": seq})
            logging.getLogger("fringed.test").warning("line %d", seq)

    with clouds.publisher() as made, Receiver(made.endpoints[0], [""], queue=1) as other:
        sender = threading.Thread(target=everything, args=(made,))
        sender.start()
        try:
            message(other)
            time.sleep(0.01 * seed)  # another phase of the sender's turn
            with Receiver(made.endpoints[0], [""], queue=2) as receiver:
                wait_until(lambda: receiver.poll(0))
                sent = made.status()["sent"].get("log", 0)
                wait_until(lambda: made.status()["sent"].get("log", 0) > sent + 40)
                stop.set()
                topics = []
                while (got := receiver.receive(0.5)) is not None:
                    topics.append(got.topic)
        finally:
            stop.set()
            sender.join()
    assert {topic for topic in topics if topic.startswith("meta/")} == {
        "meta/calibration", "meta/config", "meta/rays", "meta/schema",
    }  # fmt: skip


def test_latest_only_gives_the_newest_and_counts_the_skipped() -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], timeout_s=WAIT_S) as stream:
        connected(made)
        clouds.send(made, clouds.item(1))
        assert next(stream).header.seq == 1
        clouds.send(made, clouds.item(2))
        clouds.send(made, clouds.item(3))
        seen = [next(stream).header.seq]
        while seen[-1] != 3:  # the last one may still have been on its way
            seen.append(next(stream).header.seq)
        assert seen == sorted(seen)
        assert stream.received + stream.skipped == 3 and stream.lost == 0


def test_every_frame_mode_gives_them_all_in_order() -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], latest=False, timeout_s=WAIT_S) as stream:
        connected(made)
        seen = []
        for seq in range(10):
            clouds.send(made, clouds.item(seq))
            if seq % 3 == 2:
                seen += [next(stream).header.seq for _ in range(3)]
        seen.append(next(stream).header.seq)
    assert seen == list(range(10)) and stream.lost == 0 and stream.skipped == 0


def test_gaps_in_the_numbers_are_losses() -> None:
    losses = Losses()
    for session, seq in (("a", 5), ("a", 6), ("a", 9), ("a", 9), ("a", 8), ("a", 10), ("b", 100), ("b", 101)):
        losses.add(session, seq)
    assert losses.count == 2
    for seq in ((1 << 32) - 1, 1):
        losses.add("c", seq)
    assert losses.count == 3


def test_a_subscriber_that_never_reads_holds_nobody_up() -> None:
    with clouds.publisher() as made, Receiver(made.endpoints[0], ["cloud/"], queue=1) as stuck:
        wait_until(lambda: made.has_subscribers("cloud/full"))
        with subscribe(made.endpoints[0], timeout_s=WAIT_S) as reading:
            wait_until(lambda: len(made.status()["topics"]) == 2)
            for seq in range(60):
                clouds.send(made, clouds.item(seq, size=(256, 205)))
                assert next(reading).header.seq == seq
        assert stuck.poll(0)


def test_offering_never_waits_and_overtaken_clouds_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    busy, go_on = threading.Event(), threading.Event()

    def slow(*_: object) -> list[bytes]:
        busy.set()
        assert go_on.wait(WAIT_S)
        return [b"cloud/full", b"{}"]

    monkeypatch.setattr("daemon.live.publishing.messages.full", slow)
    with clouds.publisher() as made, Receiver(made.endpoints[0], ["cloud/full"]):
        connected(made)
        made.offer(clouds.item(0))
        assert busy.wait(WAIT_S)
        for seq in (1, 2, 3):  # the thread is held up: all return at once, the last one stays
            assert made.offer(clouds.item(seq))
        assert made.status()["dropped"] == 2
        assert made.offer(UnpairedFrame(clouds.frame("left", 1, "rgb8", clouds.SIZE)))
        go_on.set()
        wait_until(lambda: clouds.sent(made, "cloud/full") == 2)
    assert not made.offer(clouds.item(3)), "closed: refused"


def test_topics_cost_nothing_while_nobody_listens(monkeypatch: pytest.MonkeyPatch) -> None:
    made_clouds = []
    monkeypatch.setattr("daemon.live.publishing.messages.full", lambda *a: made_clouds.append(a))
    with clouds.publisher() as made, Receiver(made.endpoints[0], ["status"]) as receiver:
        connected(made, "status")
        made.offer(clouds.item(1))
        made.publish_status({"state": "running", "t_ns": 5})
        status = message(receiver)
        assert status.header.data == {"state": "running", "t_ns": 5} and not status.arrays
        assert not made.has_subscribers("cloud/full")
    assert made_clouds == []


def test_a_topic_is_left_when_the_last_listener_leaves() -> None:
    with clouds.publisher() as made:
        with subscribe(made.endpoints[0]):
            connected(made)
        wait_until(lambda: not made.has_subscribers("cloud/full"))


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "mono8", "mono16"])
def test_previews_are_jpegs_with_clipped_pixels_in_red(encoding: str) -> None:
    with clouds.publisher(preview_hz=10) as made, Receiver(made.endpoints[0], ["preview"]) as receiver:
        connected(made, "preview")
        made.offer(clouds.item(4, encoding=encoding))
        preview = message(receiver)
    images = {name: cv2.imdecode(data, cv2.IMREAD_COLOR) for name, data in preview.arrays.items()}
    assert set(images) == {"left", "right", "overlay"}
    assert all(image.shape == (26, 32, 3) for image in images.values())
    blue, _, red = images["overlay"][12, 12].astype(int)
    assert red > blue + 60


def test_previews_of_half_clouds_have_the_size_of_the_image() -> None:
    assert overlay(clouds.half(4)).shape == (26, 32, 3)


def test_previews_are_no_more_frequent_than_asked() -> None:
    with clouds.publisher(preview_hz=0.001) as made, Receiver(made.endpoints[0], ["preview", "cloud/full"]) as receiver:
        connected(made, "preview")
        connected(made)
        for seq in range(3):
            clouds.send(made, clouds.item(seq))
        topics = [message(receiver).topic]
        assert clouds.sent(made, "preview") == 1 and topics


def test_log_lines_travel() -> None:
    with clouds.publisher() as made, Receiver(made.endpoints[0], ["log"]) as receiver:
        connected(made, "log")
        logging.getLogger("fringed").warning("camera %s is warm", "left")
        data = message(receiver).header.data
    assert data == {"level": "warning", "logger": "fringed", "text": "camera left is warm"}
    assert not any(type(h).__name__ == "StreamHandler" for h in logging.getLogger("fringed").handlers)


def test_a_signal_handler_may_log_whatever_it_interrupts() -> None:
    with clouds.publisher() as made, Receiver(made.endpoints[0], ["log"]) as receiver:
        connected(made, "log")
        with made._lock:  # as when the signal comes in the middle of publish_status
            logging.getLogger("fringed").warning("SIGTERM: stopping")
        data = message(receiver).header.data
    assert isinstance(data, dict) and data["text"] == "SIGTERM: stopping"


def test_the_client_reconnects_to_a_daemon_that_was_restarted(tmp_path: Path) -> None:
    endpoint = f"ipc://{tmp_path}/stream"
    with subscribe(endpoint, timeout_s=WAIT_S) as stream:  # no publisher yet
        for session in ("first", "second"):
            with clouds.publisher(endpoint, session=session) as made:
                # ZeroMQ subscribes again only while its owner is waiting for messages, as a reader is.
                wait_until(lambda made=made: _wants(made, stream))
                made.offer(clouds.item(7))
                assert next(stream).header.session == session
        assert stream.lost == 0, "another session restarts its numbers"


def test_silence_is_an_error_and_waiting_can_go_on() -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], timeout_s=0.02) as stream:
        for _ in range(2):
            with pytest.raises(SilenceError, match="is a daemon running"):
                next(stream)


def test_async_subscribers_get_clouds() -> None:
    async def listen(made: Publisher) -> list[int]:
        seen = []
        async with asubscribe(made.endpoints[0], latest=False, timeout_s=WAIT_S) as stream:
            while not made.has_subscribers("cloud/full"):
                await asyncio.sleep(0.002)
            made.offer(clouds.item(1))
            async for cloud in stream:
                seen.append(cloud.header.seq)
                if len(seen) == 3:
                    return seen
                made.offer(clouds.item(len(seen) + 1))
        return seen

    with clouds.publisher() as made:
        assert asyncio.run(listen(made)) == [1, 2, 3]


def test_a_damaged_message_is_an_error_and_the_next_one_is_received(tmp_path: Path) -> None:
    context = zmq.Context()
    with context, context.socket(zmq.XPUB) as bad:
        bad.bind(f"ipc://{tmp_path}/bad")
        with subscribe(f"ipc://{tmp_path}/bad", latest=False, timeout_s=WAIT_S) as stream:
            assert bad.poll(8000)
            bad.send_multipart([b"cloud/full", b"{}"])
            header = wire.CloudHeader(kind="cloud", width=2, height=1)
            bad.send_multipart(wire.encode("cloud/full", header, {"xyz": np.zeros((1, 2, 3), np.float32)}))
            with pytest.raises(WireError, match="kind"):
                next(stream)
            with pytest.raises(WireError, match="'gray' is missing"):
                next(stream)


def test_ipc_directories_are_private_and_left_over_sockets_replaced(tmp_path: Path) -> None:
    path = tmp_path / "run" / "stream"
    path.parent.mkdir(mode=0o700)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(path))
    with clouds.publisher(f"ipc://{path}"):
        assert stat.S_IMODE(path.parent.stat().st_mode) & 0o027 == 0
        with pytest.raises(DaemonError, match="another daemon"), clouds.publisher(f"ipc://{path}"):
            pass
    assert not path.exists(), "removed at the end"
    with clouds.publisher(f"ipc://{tmp_path}/new/stream"):
        assert stat.S_IMODE((tmp_path / "new").stat().st_mode) == 0o700
    (tmp_path / "file").write_text("precious")
    with pytest.raises(DaemonError, match="no socket"), clouds.publisher(f"ipc://{tmp_path}/file"):
        pass
    assert (tmp_path / "file").read_text() == "precious"


def test_a_taken_port_is_named_and_nothing_is_left_open() -> None:
    threads, files = threading.active_count(), open_files()
    with clouds.publisher("tcp://127.0.0.1:0") as made:
        assert not made.endpoints[0].endswith(":0")
        with pytest.raises(DaemonError, match="cannot bind"), clouds.publisher(made.endpoints[0]):
            pass
    wait_until(lambda: threading.active_count() == threads)
    wait_until(lambda: open_files() <= files)


def test_the_daemon_opens_it_from_its_configuration(tmp_path: Path) -> None:
    config = rigs.config(tmp_path, "device: {name: rig-c}\n")
    made = open_publisher(config, rigs.rig_of(rigs.devices()), "session-c")
    try:
        with Receiver(config.stream.endpoints[0], ["meta/calibration"]) as receiver:
            came = message(receiver)
        assert (came.header.device, came.header.session) == ("rig-c", "session-c")
        assert bytes(came.arrays["calibration"]) == b"x"
    finally:
        made.close()
        made.close()


def test_wrong_endpoints_and_topics_are_refused() -> None:
    with pytest.raises(FringedError, match="tcp://HOST:PORT"):
        subscribe("rig:5555")
    with pytest.raises(FringedError, match="carries no clouds"):
        subscribe(topic="status")
