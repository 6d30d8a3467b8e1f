"""Control for other machines: each request is parsed, authorised by its sender's role, rewritten and forwarded."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import zmq

from daemon.common.counters import Counters
from daemon.control.rpc.protocol import (
    BUSY,
    FAILED,
    FORBIDDEN,
    INVALID_REQUEST,
    MAX_BYTES,
    RpcError,
    check_request,
    parse_json,
)
from daemon.keys.authorized_keys import AuthorizedKeys, Role, Service
from daemon.remote_access.gate.curve_socket import CurveSocket
from fringed.keys import Key

_MOST_WAITING, _MOST_WAITING_EACH = 256, 16
_TIMEOUT_S = 120.0
_PER_SECOND = 500.0  # requests forwarded; further ones wait in the senders' queues
_AT_ONCE = 64


@dataclass(slots=True)
class _Waiting:
    """A request without a response so far."""

    envelope: list[bytes]
    request_id: Any
    since_s: float


class ControlGate:
    """Relays between the control socket (plain, on this machine) and clients on other machines.

    Args:
        endpoints: to bind; target: the daemon's control endpoint.
        roles: of the methods; one that is not named needs ``operate``. authorized: returns the list of keys.
    """

    service: Service = "control"

    def __init__(
        self,
        context: zmq.Context[Any],
        endpoints: list[str],
        target: str,
        *,
        roles: Mapping[str, str],
        authorized: Callable[[], AuthorizedKeys],
        server: Key,
        refused: Counters,
    ) -> None:
        self._roles, self._authorized, self._refused = roles, authorized, refused
        # The margin holds what CURVE adds to a message.
        options = {zmq.MAXMSGSIZE: MAX_BYTES + 1024, zmq.RCVHWM: 64, zmq.SNDHWM: 64}
        self.public = CurveSocket(
            context, zmq.ROUTER, "control", endpoints, server=server, options=options, refused=refused
        )
        self.daemon: zmq.Socket[Any] = context.socket(zmq.DEALER)
        for option, value in ((zmq.LINGER, 0), (zmq.SNDHWM, 64), (zmq.RECONNECT_IVL, 50)):
            self.daemon.setsockopt(option, value)
        self.daemon.connect(target)
        self._waiting: dict[int, _Waiting] = {}
        self._number = 0
        self._budget, self._counted_s = _PER_SECOND, time.monotonic()
        self.forwarded = 0

    def sockets(self) -> list[zmq.Socket[Any]]:
        """Return the sockets to poll; that of the requests only while the rate permits."""
        self._refill()
        return [self.public.monitor, self.daemon, *([self.public.socket] if self._budget >= 1 else [])]

    def serve(self, ready: set[Any]) -> None:
        """Serve the sockets that are ready."""
        if self.public.monitor in ready:
            self.public.count_handshakes()
        if self.daemon in ready:
            self._responses()
        if self.public.socket in ready:
            self._requests()

    def cut(self, server: Key) -> None:
        """End every connection; pending responses are lost."""
        self._waiting.clear()
        self.public.cut(server)

    def close(self) -> None:
        """Close all sockets."""
        self.daemon.close(linger=0)
        self.public.close()

    def _refill(self) -> None:
        now_s = time.monotonic()
        self._budget = min(_PER_SECOND, self._budget + _PER_SECOND * (now_s - self._counted_s))
        self._counted_s = now_s

    def _requests(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                frames = self.public.socket.recv_multipart(zmq.NOBLOCK, copy=False)
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
            request = _parse(parts[-1])
            request_id = request.get("id")
            self._authorize(_role(frames[-1], self._authorized()), request["method"])
            self._forward(envelope, request)
        except RpcError as error:
            self._refused.add("control_role" if error.code == FORBIDDEN else "control_request")
            self._respond(envelope, {"jsonrpc": "2.0", "id": request_id, "error": error.as_object()})

    def _authorize(self, role: Role, method: str) -> None:
        needed = "view" if self._roles.get(method) == "view" else "operate"
        if role != "operate" and role != needed:
            permission = "only view" if role == "view" else "do nothing"
            raise RpcError(FORBIDDEN, f"{method:.60}: this key may {permission}, the method needs operate")

    def _forward(self, envelope: list[bytes], request: dict[str, Any]) -> None:
        """Forward a rewritten request, so that the daemon cannot parse anything else than what was authorised here."""
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
        self.forwarded += 1
        if "id" in request:
            self._waiting[self._number] = _Waiting(envelope, request["id"], time.monotonic())

    def _make_room(self, envelope: list[bytes]) -> None:
        oldest_s = time.monotonic() - _TIMEOUT_S
        for number in [number for number, one in self._waiting.items() if one.since_s < oldest_s]:
            del self._waiting[number]
        own = sum(one.envelope[0] == envelope[0] for one in self._waiting.values())
        if len(self._waiting) >= _MOST_WAITING or own >= _MOST_WAITING_EACH:
            raise RpcError(BUSY, "too many requests wait for the daemon; wait for their responses")

    def _responses(self) -> None:
        for _ in range(_AT_ONCE):
            try:
                parts = self.daemon.recv_multipart(zmq.NOBLOCK)
            except zmq.Again:
                return
            response = json.loads(parts[-1])
            waiting = self._waiting.pop(response.get("id", 0), None) if isinstance(response, dict) else None
            if waiting is not None:
                self._respond(waiting.envelope, response | {"id": waiting.request_id})

    def _respond(self, envelope: list[bytes], response: dict[str, Any]) -> None:
        try:
            self.public.socket.send_multipart([*envelope, json.dumps(response).encode()], zmq.NOBLOCK)
        except zmq.ZMQError:  # a client that reads nothing, or has gone
            self._refused.add("control_answer")


def _parse(message: bytes) -> dict[str, Any]:
    """Return the one request of a message."""
    request = parse_json(message)
    if isinstance(request, list):
        raise RpcError(INVALID_REQUEST, "batches are not accepted from other machines; send one request at a time")
    check_request(request)
    return dict(request)


def _role(frame: Any, authorized: AuthorizedKeys) -> Role:
    """Return the present role of a frame's sender, which may have changed since it connected."""
    try:
        return authorized.role("control", str(frame.get("User-Id")))
    except (zmq.ZMQError, UnicodeDecodeError):
        return "none"
