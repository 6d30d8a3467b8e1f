"""Control for other machines: each request is read, judged by its sender's role, written anew and passed on."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import zmq

from daemon.common.counters import Counters
from daemon.control.rpc.protocol import BUSY, FAILED, FORBIDDEN, INVALID_REQUEST, MAX_BYTES, PARSE_ERROR, RpcError
from daemon.keys.authorized_keys import Allowed, Role, Service
from daemon.remote_access.gate.curve_socket import Front
from fringed.keys import Key

_MOST_WAITING, _MOST_WAITING_EACH = 256, 16
_PATIENCE_S = 120.0
_PER_SECOND = 500.0  # requests passed on; more than that wait in the senders' queues
_AT_ONCE = 64


@dataclass(slots=True)
class _Waiting:
    """A request that the daemon has not answered yet."""

    envelope: list[bytes]
    request_id: Any
    since_s: float


class ControlGate:
    """Between control (plain, on this machine) and clients elsewhere.

    Args:
        endpoints: to bind; target: the daemon's control endpoint.
        roles: of the methods; one that is not named needs ``operate``. allowed: gives the list of keys.
    """

    service: Service = "control"

    def __init__(
        self,
        context: zmq.Context[Any],
        endpoints: list[str],
        target: str,
        *,
        roles: Mapping[str, str],
        allowed: Callable[[], Allowed],
        server: Key,
        refused: Counters,
    ) -> None:
        self._roles, self._allowed, self._refused = roles, allowed, refused
        # What CURVE adds to a message fits into the rest.
        options = {zmq.MAXMSGSIZE: MAX_BYTES + 1024, zmq.RCVHWM: 64, zmq.SNDHWM: 64}
        self.front = Front(context, zmq.ROUTER, "control", endpoints, server=server, options=options, refused=refused)
        self.daemon: zmq.Socket[Any] = context.socket(zmq.DEALER)
        for option, value in ((zmq.LINGER, 0), (zmq.SNDHWM, 64), (zmq.RECONNECT_IVL, 50)):
            self.daemon.setsockopt(option, value)
        self.daemon.connect(target)
        self._waiting: dict[int, _Waiting] = {}
        self._number = 0
        self._budget, self._counted_s = _PER_SECOND, time.monotonic()
        self.passed = 0

    def sockets(self) -> list[zmq.Socket[Any]]:
        """What to wait for; requests only while there is room for them."""
        self._refill()
        return [self.front.monitor, self.daemon, *([self.front.socket] if self._budget >= 1 else [])]

    def serve(self, ready: set[Any]) -> None:
        """Do what the sockets that are ready ask for."""
        if self.front.monitor in ready:
            self.front.count_handshakes()
        if self.daemon in ready:
            self._answers()
        if self.front.socket in ready:
            self._requests()

    def cut(self, server: Key) -> None:
        """End every connection; answers that are on their way are lost."""
        self._waiting.clear()
        self.front.cut(server)

    def close(self) -> None:
        """End everything."""
        self.daemon.close(linger=0)
        self.front.close()

    def _refill(self) -> None:
        now_s = time.monotonic()
        self._budget = min(_PER_SECOND, self._budget + _PER_SECOND * (now_s - self._counted_s))
        self._counted_s = now_s

    def _requests(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                frames = self.front.socket.recv_multipart(zmq.NOBLOCK, copy=False)
            except zmq.Again:
                return
            self._request(frames)
            if self._budget < 1:
                return

    def _request(self, frames: list[Any]) -> None:
        parts = [frame.bytes for frame in frames[:4]]
        if not 2 <= len(frames) <= 3 or (len(frames) == 3 and parts[1]):
            self._refused.add("control_request")
            return
        envelope, request_id = parts[:-1], None
        try:
            request = _read(parts[-1])
            request_id = request.get("id")
            self._judge(_role(frames[-1], self._allowed()), request["method"])
            self._pass_on(envelope, request)
        except RpcError as error:
            self._refused.add("control_role" if error.code == FORBIDDEN else "control_request")
            self._answer(envelope, {"jsonrpc": "2.0", "id": request_id, "error": error.as_object()})

    def _judge(self, role: Role, method: str) -> None:
        needed = "view" if self._roles.get(method) == "view" else "operate"
        if role != "operate" and role != needed:
            raise RpcError(FORBIDDEN, f"{method:.60}: this key may {_words(role)}, the method needs operate")

    def _pass_on(self, envelope: list[bytes], request: dict[str, Any]) -> None:
        """Written anew, so that the daemon cannot read anything else in it than what was judged here."""
        fresh = {"jsonrpc": "2.0", "method": request["method"], "params": request.get("params", {})}
        if "id" in request:
            self._make_room(envelope)
            self._number += 1
            fresh["id"] = self._number
        try:
            text = json.dumps(fresh, allow_nan=False).encode()
        except RecursionError:
            raise RpcError(INVALID_REQUEST, "nested too deeply") from None
        if len(text) > MAX_BYTES:
            raise RpcError(
                INVALID_REQUEST, f"{len(text)} bytes when written in full, a request has at most {MAX_BYTES}"
            )
        try:
            self.daemon.send(text, zmq.NOBLOCK)
        except zmq.Again:
            raise RpcError(FAILED, "the daemon does not take requests; try again") from None
        self._budget -= 1
        self.passed += 1
        if "id" in request:
            self._waiting[self._number] = _Waiting(envelope, request["id"], time.monotonic())

    def _make_room(self, envelope: list[bytes]) -> None:
        oldest_s = time.monotonic() - _PATIENCE_S
        for number in [number for number, one in self._waiting.items() if one.since_s < oldest_s]:
            del self._waiting[number]
        own = sum(one.envelope[0] == envelope[0] for one in self._waiting.values())
        if len(self._waiting) >= _MOST_WAITING or own >= _MOST_WAITING_EACH:
            raise RpcError(BUSY, "too many requests wait for the daemon; wait for their answers")

    def _answers(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                parts = self.daemon.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            response = json.loads(parts[-1])
            waiting = self._waiting.pop(response.get("id", 0), None) if isinstance(response, dict) else None
            if waiting is not None:
                self._answer(waiting.envelope, response | {"id": waiting.request_id})

    def _answer(self, envelope: list[bytes], response: dict[str, Any]) -> None:
        try:
            self.front.socket.send_multipart([*envelope, json.dumps(response).encode()], zmq.NOBLOCK)
        except zmq.ZMQError:  # a client that reads nothing, or has gone
            self._refused.add("control_answer")


def _read(message: bytes) -> dict[str, Any]:
    """The one request of a message."""
    try:
        request = json.loads(message.decode("utf-8"), parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise RpcError(PARSE_ERROR, f"not JSON: {type(error).__name__}") from error
    if isinstance(request, list):
        raise RpcError(INVALID_REQUEST, "batches are not taken from other machines; send one request at a time")
    if not isinstance(request, dict) or request.get("jsonrpc") != "2.0":
        raise RpcError(INVALID_REQUEST, 'not a JSON-RPC 2.0 request: "jsonrpc": "2.0" is missing')
    request_id = request.get("id")
    proper = isinstance(request_id, str | int | float | None) and not isinstance(request_id, bool)
    if not isinstance(request.get("method"), str) or not proper:
        raise RpcError(INVALID_REQUEST, "a request has a text as method, and a text or number as id")
    return request


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _role(frame: Any, allowed: Allowed) -> Role:
    """What the sender of a frame may do now, whatever it might when it connected."""
    try:
        return allowed.role("control", str(frame.get("User-Id")))
    except (zmq.ZMQError, UnicodeDecodeError):
        return "none"


def _words(role: Role) -> str:
    return "only view" if role == "view" else "do nothing"
