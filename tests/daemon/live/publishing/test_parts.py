"""Clouds with the parts that a subscriber asks for: no other one gets them, and without one they are not computed."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zmq

from daemon.common.errors import ConfigError
from daemon.live.items import CloudItem
from daemon.live.publishing import messages
from daemon.live.publishing.messages import Origin
from fringed import FringedError, subscribe, wire
from fringed.parts import BASIC, PARTS, topic_of
from tests.daemon import rigs
from tests.daemon.live.publishing import clouds
from tools.waiting import wait_until

WAIT_S = 8.0
ORIGIN = Origin("rig-t", "session-1", "sha256:00")


def rich(seq: int = 3) -> CloudItem:
    """A cloud with every part."""
    item = clouds.item(seq)
    rng, shape = np.random.default_rng(seq), item.cloud.gray.shape
    normals = rng.standard_normal((*shape, 3)).astype(np.float32)
    rgb = rng.integers(0, 256, (*shape, 3), dtype=np.uint8)
    filled = (rng.random(shape) < 0.1).astype(np.uint8)
    return replace(item, cloud=replace(item.cloud, rgb=rgb, normals=normals, interpolated=filled))


def test_a_subscriber_gets_what_it_asks_for_bit_for_bit() -> None:
    item = rich()
    with clouds.publisher() as made, subscribe(made.endpoints[0], parts=list(PARTS), timeout_s=WAIT_S) as stream:
        wait_until(lambda: made.wanted_parts() == frozenset(PARTS))
        made.offer(item)
        cloud = next(stream)
    assert [part.name for part in cloud.header.parts] == list(PARTS)
    for name in ("xyz", "gray", "rgb", "normals", "interpolated"):
        np.testing.assert_array_equal(getattr(cloud, name), getattr(item.cloud, name))
    np.testing.assert_array_equal(cloud.sigma, item.cloud.sigma_mm)
    assert cloud.interpolated is not None and cloud.interpolated.dtype == np.bool_


def test_what_was_not_asked_for_is_not_sent() -> None:
    with clouds.publisher() as made, subscribe(made.endpoints[0], parts=("xyz", "rgb"), timeout_s=WAIT_S) as stream:
        wait_until(lambda: made.wanted_parts() == {"xyz", "rgb"})
        made.offer(rich())
        cloud = next(stream)
    assert [part.name for part in cloud.header.parts] == ["xyz", "rgb"]
    assert cloud.gray is None and cloud.sigma is None and cloud.normals is None and cloud.rgb is not None


def test_parts_are_wanted_as_long_as_one_subscribes() -> None:
    with clouds.publisher() as made:
        assert made.wanted_parts() == frozenset()
        with subscribe(made.endpoints[0], parts=("xyz", "normals")):
            wait_until(lambda: "normals" in made.wanted_parts())
        wait_until(lambda: made.wanted_parts() == frozenset())
        with subscribe(made.endpoints[0]):
            wait_until(lambda: made.has_subscribers("cloud/full"))
            assert made.wanted_parts() == frozenset()


def test_a_cloud_that_was_made_before_is_left_out() -> None:
    """Between the subscription and the first cloud with its parts: never a message without what it promises."""
    with clouds.publisher() as made, subscribe(made.endpoints[0], parts=("xyz", "rgb"), timeout_s=WAIT_S) as stream:
        wait_until(lambda: "rgb" in made.wanted_parts())
        clouds.send(made, rich(1), topic_of(("xyz", "rgb")))
        made.offer(clouds.item(2))
        clouds.send(made, rich(3), topic_of(("xyz", "rgb")))
        stream.latest = False
        assert [next(stream).header.seq for _ in range(2)] == [1, 3]
        assert "problem" not in made.status()


def test_readers_of_the_basic_topic_get_the_same_message_whatever_others_ask_for() -> None:
    plain, full = clouds.item(5), rich(5)
    full = replace(full, cloud=replace(full.cloud, interpolated=None))
    assert [bytes(frame) for frame in messages.full(ORIGIN, plain)] == [
        bytes(frame) for frame in messages.full(ORIGIN, full)
    ]


def test_interpolated_points_are_marked_in_the_basic_topic() -> None:
    marks = wire.decode(messages.full(ORIGIN, rich())).arrays["interpolated"]
    np.testing.assert_array_equal(marks, rich().cloud.interpolated)
    assert marks.any()


def test_configured_parts_are_announced_in_the_basic_topic() -> None:
    with (
        clouds.publisher(parts=(*BASIC, "rgb", "interpolated")) as made,
        subscribe(made.endpoints[0], timeout_s=WAIT_S) as stream,
    ):
        wait_until(lambda: made.has_subscribers("cloud/full"))
        made.offer(rich())
        cloud = next(stream)
    assert [part.name for part in cloud.header.parts] == [*BASIC, "rgb", "interpolated"]
    assert cloud.rgb is not None and cloud.normals is None


def test_without_filling_no_point_is_interpolated() -> None:
    frames = messages.parts(ORIGIN, clouds.item(1), "t", ("xyz", "interpolated"))
    assert frames is not None and not wire.decode(frames).arrays["interpolated"].any()


def test_a_plain_reader_needs_only_the_topic() -> None:
    with clouds.publisher() as made, zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.RCVTIMEO, int(1000 * WAIT_S))
        socket.subscribe(b"cloud/parts/xyz,normals/")
        socket.connect(made.endpoints[0])
        wait_until(lambda: "normals" in made.wanted_parts())
        item = rich()
        made.offer(item)
        topic, header, _, normals = socket.recv_multipart()
    (_, row) = json.loads(header)["parts"]
    assert (topic, row["name"], row["dtype"]) == (b"cloud/parts/xyz,normals/", "normals", "<f4")
    found = np.frombuffer(normals, row["dtype"]).reshape(row["shape"])
    np.testing.assert_array_equal(found, item.cloud.normals)


def test_a_wrong_part_is_refused_where_it_is_asked_for() -> None:
    with pytest.raises(FringedError, match="there is no part 'nonsense'"):
        subscribe("tcp://127.0.0.1:9", parts=("xyz", "nonsense"))
    with clouds.publisher() as made, zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.setsockopt(zmq.LINGER, 0)
        socket.subscribe(b"cloud/parts/xyz,nonsense/")
        socket.connect(made.endpoints[0])
        wait_until(lambda: made.has_subscribers("cloud/parts/xyz,nonsense/"))
        assert made.wanted_parts() == frozenset()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("[xyz, gray, sigma, nonsense]", "there is no part 'nonsense'; choose from xyz"),
        ("[xyz, gray, sigma, rgb, rgb]", "names the part 'rgb' 2 times"),
        ("[]", "names no part"),
        ("[xyz, rgb]", "gray, sigma is missing; readers of cloud/full need xyz, gray, sigma"),
        ("rgb", "should be a valid array, got .rgb."),
        ("[1]", "string"),
    ],
)
def test_a_wrong_configuration_is_refused(value: str, message: str, tmp_path: Any) -> None:
    with pytest.raises(ConfigError, match=message):
        rigs.config(tmp_path, f"outputs: {{parts: {value}}}\n")


def test_a_configuration_gives_the_parts_in_the_order_of_messages(tmp_path: Any) -> None:
    assert tuple(rigs.config(tmp_path).outputs.parts) == BASIC
    config = rigs.config(tmp_path, "outputs: {parts: [normals, sigma, rgb, gray, xyz]}\n")
    assert config.outputs.parts == ["xyz", "gray", "sigma", "rgb", "normals"]
