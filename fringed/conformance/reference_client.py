"""A client that passes the check: what a client in another language has to do, in few lines."""

from __future__ import annotations

import json
import time
from typing import Any, TextIO

import zmq

from fringed import wire
from fringed.conformance.recorded import decoded, expected
from fringed.errors import WireError


def run(stream: str, control: str, out: TextIO, *, timeout_s: float = 30.0) -> None:
    """Receive every message once, call every recorded method, and write the results as lines of JSON."""
    with zmq.Context() as context:
        with context.socket(zmq.SUB) as socket:
            socket.setsockopt(zmq.RCVHWM, 64)
            socket.connect(stream)
            socket.subscribe(b"")
            _receive(socket, out, time.monotonic() + timeout_s)
        with context.socket(zmq.DEALER) as socket:
            socket.setsockopt(zmq.LINGER, 0)
            socket.connect(control)
            for number, exchange in enumerate(expected()["control"]):
                request = {"method": exchange["method"], "params": exchange["params"]}
                socket.send(json.dumps({"jsonrpc": "2.0", "id": number, **request}).encode())
                if not socket.poll(round(1000 * timeout_s)):
                    return
                response = json.loads(socket.recv())
                _write(out, request | {key: response[key] for key in ("result", "error") if key in response})


def _receive(socket: zmq.Socket[bytes], out: TextIO, end_s: float) -> None:
    rays: Any = None
    missing = {(row["topic"], row["header"]["seq"]) for row in expected()["messages"]}
    missing |= {(row["topic"], None) for row in expected()["refused"]}
    while missing and socket.poll(max(0, round(1000 * (end_s - time.monotonic())))):
        frames = socket.recv_multipart()
        try:
            row = decoded(frames, rays)
        except WireError as error:
            topic = frames[0].decode()
            if (topic, None) in missing:
                missing.discard((topic, None))
                _write(out, {"topic": topic, "error": str(error)})
            continue
        if row["topic"] == "meta/rays":
            rays = wire.decode(frames).arrays["rays"]
        key = (row["topic"], row["header"]["seq"])
        if row["topic"] == "cloud/depth" and "points" not in row:
            continue  # the rays come first; this one was under way before the subscription
        if key in missing:
            missing.discard(key)
            _write(out, row)


def _write(out: TextIO, row: dict[str, Any]) -> None:
    out.write(json.dumps(row) + "\n")
