"""A server that replays the recorded messages, and answers the recorded requests."""

from __future__ import annotations

import json
import threading
from typing import Any

import zmq

from fringed.conformance.recorded import Frames, exchanges, messages
from fringed.protocol.limits import LIMITS

_PREFIX_BYTES, _REQUEST_BYTES = LIMITS["stream: subscription, bytes"], LIMITS["control: request, bytes"]
_RETAINED = b"meta/"


class Server:
    """Publishes every recorded message again and again, and answers on a second socket, until :meth:`close`.

    A new subscriber gets the ``meta/`` messages at once, as from a daemon. Malformed messages have topics that begin
    with ``refused/``.

    Args:
        stream, control: addresses to bind; port ``*`` takes a free one.
        period_s: between two messages.
    """

    def __init__(self, stream: str, control: str, *, period_s: float = 0.05) -> None:
        everything = messages("valid") + messages("refused")
        self._retained = [frames for frames in everything if frames[0].startswith(_RETAINED)]
        self._cycle = [frames for frames in everything if not frames[0].startswith(_RETAINED)]
        self._answers = {_key(row["request"]): row["response"] for row in exchanges()}
        self._period_ms = max(1, round(1000 * period_s))
        self._context: zmq.Context[zmq.Socket[bytes]] = zmq.Context()
        self._stream, self._control = self._context.socket(zmq.XPUB), self._context.socket(zmq.ROUTER)
        self._stream.setsockopt(zmq.XPUB_VERBOSE, 1)
        self._stream.setsockopt(zmq.SNDHWM, LIMITS["stream: messages that wait for a slow subscriber"])
        self._control.setsockopt(zmq.MAXMSGSIZE, _REQUEST_BYTES)
        try:
            self._stream.bind(stream)
            self._control.bind(control)
        except zmq.ZMQError:
            self._context.destroy(linger=0)
            raise
        #: Addresses with their real ports.
        self.stream, self.control = (_bound(socket) for socket in (self._stream, self._control))
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="conformance", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End; may be called twice."""
        self._closing.set()
        self._thread.join(5.0)
        self._context.destroy(linger=0)

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        poller, number = zmq.Poller(), 0
        for socket in (self._stream, self._control):
            poller.register(socket, zmq.POLLIN)
        while not self._closing.is_set():
            ready = dict(poller.poll(self._period_ms))
            if self._stream in ready:
                self._subscribed(self._stream.recv())
            if self._control in ready:
                *sender, request = self._control.recv_multipart()
                response = answer(request, self._answers)
                if response is not None:
                    self._control.send_multipart([*sender, response])
            if not ready:
                self._send(self._cycle[number % len(self._cycle)])
                number += 1

    def _subscribed(self, message: bytes) -> None:
        if message[:1] == b"\1" and len(message) <= 1 + _PREFIX_BYTES:
            for frames in self._retained:
                if frames[0].startswith(message[1:]):
                    self._send(frames)

    def _send(self, frames: Frames) -> None:
        self._stream.send_multipart(frames)


def answer(message: bytes, answers: dict[str, Any]) -> bytes | None:
    """Return the response to a message as a daemon gives it: for a request, a batch, or what is neither."""
    try:
        parsed = json.loads(message)
    except ValueError:
        return json.dumps(_error(None, -32700, "not JSON")).encode()
    if isinstance(parsed, list):
        batch = [response for request in parsed if (response := _response(request, answers)) is not None]
        return json.dumps(batch).encode() if batch else None
    response = _response(parsed, answers)
    return None if response is None else json.dumps(response).encode()


def _response(request: Any, answers: dict[str, Any]) -> dict[str, Any] | None:
    if not isinstance(request, dict) or request.get("jsonrpc") != "2.0" or not isinstance(request.get("method"), str):
        return _error(None, -32600, "not a JSON-RPC 2.0 request")
    if "id" not in request:
        return None
    recorded = answers.get(_key(request))
    if recorded is not None:
        return {**recorded, "id": request["id"]}
    return _error(request["id"], -32601, "the kit has no recorded answer to this request")


def _error(request_id: Any, code: int, text: str) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": request_id, "error": {"code": code, "message": text}}


def _key(request: dict[str, Any]) -> str:
    return json.dumps([request["method"], request.get("params", {})], sort_keys=True)


def _bound(socket: zmq.Socket[bytes]) -> str:
    endpoint: bytes = socket.getsockopt(zmq.LAST_ENDPOINT)  # type: ignore[assignment]
    return endpoint.rstrip(b"\0").decode()
