"""Records the messages of the conformance kit; only when they must change.

``python -m tests.fringed.conformance.make``: a daemon measures a simulated scene of 64 x 51 pixels, and a plain socket
records its stream and its answers. Messages that a short run does not give, and malformed ones, are made from them.
"""

from __future__ import annotations

import json
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import zmq

import fringed.conformance
from fringed import wire
from fringed.conformance.recorded import Frames, decoded, pack
from fringed.errors import WireError
from fringed.parts import shared_topic
from fringed.parts import topic_of as topic_with
from fringed.protocol.topics import RECORDED, Topic, topic_of
from tests import kernels
from tests.daemon.whole_daemon import RIG, measuring

BY_PARTS = topic_with(("xyz", "rgb", "normals", "interpolated"))
STREAMS = Path(fringed.conformance.__file__).parent / "streams"
CALLS: list[tuple[str, Any]] = [
    ("hello", {}), ("status", {}), ("get", {"path": "pairing"}), ("get", {"path": "pairing.tolerance_us"}),
    ("get", {"path": "pairing.tolerance_us", "detail": True}), ("get", {"path": "no.such"}),
    ("get", ["pairing", False]),
    ("set", {"path": "pairing.tolerance_us", "value": 1800}), ("set", {"path": "pairing.tolerance_us", "value": -1}),
    ("set", {"path": "device.name", "value": "other"}), ("reload", {}), ("health", {}), ("health.events", {"most": 5}),
    ("health.history", {"quantities": ["cloud_rate_hz"], "seconds": 60, "points": 4}), ("snapshot", {"name": "kit"}),
    ("record.start", {"name": "kit", "before_s": 1.0}), ("record.stop", {}), ("takes.list", {}), ("pattern.mode", {}),
    ("pattern.show", {"name": "fringe"}), ("pattern.show", {"name": "violet"}), ("calibrate.status", {}),
    ("calibrate.capture", {"frames": []}), ("calibrate.next_pose", {}), ("calibrate.cancel", {}), ("stop", {}),
    ("start", {}), ("status", {"unknown": 1}), ("no.such", {}),
]  # fmt: skip


def main() -> None:
    """Record and write all files of the kit."""
    folder = Path(tempfile.gettempdir()) / "fringed-conformance"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir()
    assert not (problem := kernels.compile_all()), problem
    with measuring(folder, RIG.replace("plane", "spheres")) as control:
        exchanges = record_control(control)
        recorded = record_stream(f"ipc://{folder}/s", control)
    valid, refused = recorded + variants(recorded), malformed(recorded)
    rays = next(wire.decode(frames).arrays["rays"] for frames in valid if frames[0] == b"meta/rays")
    expected = {
        "messages": [decoded(frames, rays) for frames in valid],
        "refused": [{"topic": frames[0].decode(), "reason": reason} for frames, reason in refused],
        "control": [expectation(exchange) for exchange in exchanges],
    }
    STREAMS.mkdir(exist_ok=True)
    (STREAMS / "valid.bin").write_bytes(pack(valid))
    (STREAMS / "refused.bin").write_bytes(pack([frames for frames, _ in refused]))
    for name, value in (("control", exchanges), ("expected", expected)):
        (STREAMS / f"{name}.json").write_text(json.dumps(value, indent=1) + "\n", encoding="utf-8")


def record_stream(endpoint: str, control: str, topics: Sequence[Topic] = RECORDED) -> list[Frames]:
    """Every retained message, two clouds with their depth, a preview, two status messages and a log line."""
    wanted = {topic.name: 1 for topic in topics} | {"cloud/full": 2, "cloud/depth": 2, "status": 2}
    got: dict[str, list[Frames]] = defaultdict(list)
    with zmq.Context() as context, context.socket(zmq.SUB) as socket:
        socket.connect(endpoint)
        for prefix in ("", BY_PARTS, shared_topic(BY_PARTS)):
            socket.subscribe(prefix)
        end_s = time.monotonic() + 60
        while any(len(got[topic]) < count for topic, count in wanted.items()):
            assert time.monotonic() < end_s, dict(wanted)
            frames = socket.recv_multipart()
            topic = topic_of(frames[0].decode()).name
            if topic == "cloud/depth" and not any(number(frames) == number(other) for other in got["cloud/full"]):
                continue
            if len(got[topic]) < wanted.get(topic, 0):
                got[topic].append(frames)
            if not got["log"]:
                for value in (1800, 2000):
                    call(control, "set", {"path": "pairing.tolerance_us", "value": value}, 1)
    return [frames for topic in topics for frames in got[topic.name]]


def record_control(control: str) -> list[dict[str, Any]]:
    """Each request with its response."""
    return [call(control, method, params, number) for number, (method, params) in enumerate(CALLS, 1)]


def call(control: str, method: str, params: Any, number: int) -> dict[str, Any]:
    """One request on a connection of its own."""
    request = {"jsonrpc": "2.0", "id": number, "method": method, "params": params}
    with zmq.Context() as context, context.socket(zmq.DEALER) as socket:
        socket.connect(control)
        socket.send(json.dumps(request).encode())
        assert socket.poll(60_000), method
        return {"request": request, "response": json.loads(socket.recv())}


def expectation(exchange: dict[str, Any]) -> dict[str, Any]:
    """What a client reports of a call."""
    request, response = exchange["request"], exchange["response"]
    row = {"method": request["method"], "params": request["params"]}
    return row | ({"code": response["error"]["code"]} if "error" in response else {"result": response["result"]})


def number(frames: Frames) -> int:
    return wire.decode_header(frames)[1].seq


def edited(frames: Frames, **changes: Any) -> Frames:
    """The message with other keys in its header."""
    return [frames[0], json.dumps(json.loads(frames[1]) | changes).encode(), *frames[2:]]


def variants(recorded: list[Frames]) -> list[Frames]:
    """Valid messages that a reader must handle and that a short run does not give."""
    first = next(frames for frames in recorded if frames[0] == b"cloud/full")
    message, seq = wire.decode(first), number(first)
    stats = json.loads(first[1])["stats"]
    half = {name: array[::2, ::2] for name, array in message.arrays.items()}
    height, width = half["gray"].shape
    halved = [bytes(frame) for frame in wire.encode("cloud/full", message.header, half)]
    future = edited(
        first, seq=seq + 1002, flavour={"new": [1, 2]}, stats=stats | {"unheard": "of"},
        parts=[*json.loads(first[1])["parts"], {"name": "future", "dtype": "<i2", "shape": [2], "codec": "none"}],
    )  # fmt: skip
    return [
        edited(halved, seq=seq + 1000, width=width, height=height, stats=stats | {"every": 2}),
        edited(first, seq=seq + 1001, stats=stats | {"mode": "gray", "frames": 14, "span_ms": 650.0, "moved": 12}),
        [*future, b"\x01\x00\x02\x00"],
    ]


def malformed(recorded: list[Frames]) -> list[tuple[Frames, str]]:
    """Messages that a reader must refuse, each with the reason."""
    message = wire.decode(next(frames for frames in recorded if frames[0] == b"cloud/full"))
    small = {name: array[20:23, 30:34].copy() for name, array in message.arrays.items()}
    head = wire.CloudHeader(
        kind="cloud", seq=7, width=4, height=3, stats={"valid": 1.0, "latency_ms": 1.0, "dropped": 0}
    )
    good = [bytes(frame) for frame in wire.encode("cloud/full", head, small)]
    depth = [
        bytes(frame)
        for frame in wire.encode(
            "cloud/depth", head, {"z": np.arange(12, dtype=np.uint16).reshape(3, 4)},
            rows={"z": {"codec": "blosc2", "scale": 0.1, "offset": 5.0}},
        )
    ]  # fmt: skip
    rows = json.loads(good[1])["parts"]

    def row(**changes: Any) -> Frames:
        return edited(good, parts=[rows[0] | changes, *rows[1:]])

    cases: dict[str, tuple[Callable[[], Frames], str]] = {
        "version": (lambda: edited(good, v=2), "v is 2"),
        "no-kind": (lambda: [good[0], b'{"v": 1}', *good[2:]], "the header has no kind"),
        "not-json": (lambda: [good[0], good[1][:-1], *good[2:]], "the header is no JSON"),
        "not-utf8": (lambda: [good[0], b'{"kind": "\xff"}', *good[2:]], "the header is not UTF-8"),
        "long-header": (lambda: [good[0], good[1].ljust(4097), *good[2:]], "the header has more than 4096 bytes"),
        "no-header": (lambda: [good[0]], "the header is missing"),
        "part-missing": (lambda: good[:-1], "fewer parts than rows"),
        "part-added": (lambda: [*good, b"\x00"], "more parts than rows"),
        "part-short": (lambda: [*good[:-1], good[-1][:-1]], "a part is shorter than its shape"),
        "part-long": (lambda: [*good[:-1], good[-1] + b"\x00"], "a part is longer than its shape"),
        "dtype": (lambda: row(dtype="<f2"), "the dtype is unknown"),
        "codec": (lambda: row(codec="zip"), "the codec is unknown"),
        "shape": (lambda: row(shape=[3, -4, 3]), "a size is negative"),
        "dimensions": (lambda: row(shape=[3, 4, 3, 1, 1]), "five dimensions"),
        "huge": (lambda: row(shape=[1 << 20, 1 << 20]), "a part over 1 GiB"),
        "same-name": (lambda: row(name="gray", dtype="<f4"), "two parts have one name"),
        "width": (lambda: edited(good, width=0), "the width is 0"),
        "blosc2-size": (
            lambda: edited(depth, parts=[json.loads(depth[1])["parts"][0] | {"shape": [4, 4]}]),
            "the chunk unpacks to another size than its shape",
        ),
        "blosc2-damaged": (lambda: [*depth[:-1], b"\x02" * len(depth[-1])], "the chunk is damaged"),
    }
    out = []
    for name, (make, reason) in cases.items():
        frames = [f"refused/{name}".encode(), *make()[1:]]
        try:
            wire.decode(frames)
        except WireError:
            out.append((frames, reason))
        else:
            raise AssertionError(name)
    return out


if __name__ == "__main__":
    main()
