"""JSON-RPC 2.0 from bytes to bytes: every input gives a valid response or none.

Requests, notifications (no ``id``, no response) and batches of at most 32; parameters by name or by position.
"""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from daemon.common.errors import DaemonError
from drivers.errors import DriverError

log = logging.getLogger("fringed.control")

MAX_BYTES = 64 * 1024
MAX_ANSWER_BYTES = 1024 * 1024
MAX_BATCH = 32

PARSE_ERROR, INVALID_REQUEST, METHOD_NOT_FOUND, INVALID_PARAMS, INTERNAL_ERROR = -32700, -32600, -32601, -32602, -32603
FAILED, FORBIDDEN, BUSY = -32000, -32001, -32002


class RpcError(Exception):
    """An error that is reported to the caller.

    Args:
        path: of the setting or parameter it concerns; data: more members of the error's ``data``.
    """

    def __init__(
        self, code: int, message: str, path: str | None = None, *, data: Mapping[str, Any] | None = None
    ) -> None:
        super().__init__(message)
        self.code, self.message, self.path, self.data = code, message, path, dict(data or {})

    def as_object(self) -> dict[str, Any]:
        """Return the ``error`` member of a response."""
        data = self.data | ({} if self.path is None else {"path": self.path})
        return {"code": self.code, "message": self.message} | ({"data": data} if data else {})


class Role(StrEnum):
    """Permissions of a caller: read only, or everything."""

    VIEW = "view"
    OPERATE = "operate"


@dataclass(frozen=True, slots=True)
class Method:
    """One method of the table.

    Args:
        call: called with the parameters by name; params: their names, in the order of parameters by position.
        role: that a caller needs at least.
        slow: may wait (for a disk, for the pipeline): it is executed in the background, one at a time.
    """

    call: Callable[[dict[str, Any]], Any]
    params: tuple[str, ...] = ()
    role: Role = Role.OPERATE
    slow: bool = False

    def __call__(self, params: dict[str, Any]) -> Any:
        """Return the result; RpcError for unknown parameters and for what the daemon refuses."""
        unknown = sorted(set(params) - set(self.params))
        if unknown:
            known = ", ".join(self.params) or "none"
            raise RpcError(INVALID_PARAMS, f"unknown parameter {unknown[0]!r:.60}; known: {known}")
        try:
            return self.call(params)
        except (DaemonError, DriverError, OSError) as error:
            raise RpcError(FAILED, str(error)) from error


class RequestMessage:
    """A received message: one request, a batch of them, or a ``problem``."""

    def __init__(self, message: bytes) -> None:
        self.problem: RpcError | None = None
        self._requests: list[Any] = []
        self._batch = False
        try:
            parsed = parse_json(message)
        except RpcError as error:
            self.problem = error
            return
        self._batch = isinstance(parsed, list)
        self._requests = parsed if isinstance(parsed, list) else [parsed]
        if self._batch and not 0 < len(parsed) <= MAX_BATCH:
            self.problem = RpcError(INVALID_REQUEST, f"a batch has 1 to {MAX_BATCH} requests, this one {len(parsed)}")

    @property
    def name(self) -> str:
        """The requested method, for messages to people."""
        if self._batch:
            return f"a batch of {len(self._requests)}"
        return f"{self._requests[0].get('method', '')!s:.60}" if isinstance(self._requests[0], dict) else ""

    def slow(self, methods: Mapping[str, Method]) -> bool:
        """Whether any of its methods may wait."""
        if self.problem is not None:
            return False
        named = [request.get("method") for request in self._requests if isinstance(request, dict)]
        return any(isinstance(name, str) and name in methods and methods[name].slow for name in named)

    def respond(self, methods: Mapping[str, Method], role: Role = Role.OPERATE) -> bytes | None:
        """Execute the requests and return the response, None for notifications."""
        return self._each(lambda request: _call(request, methods, role))

    def refuse(self, error: RpcError) -> bytes | None:
        """Return an error as the response to every request; execute none."""

        def refuse(_: dict[str, Any]) -> Any:
            raise error

        return self._each(refuse)

    def _each(self, call: Callable[[dict[str, Any]], Any]) -> bytes | None:
        if self.problem is not None:
            return _encoded(_error_response(None, self.problem))
        responses = [response for request in self._requests if (response := _response(request, call)) is not None]
        if not responses:
            return None
        return _encoded(responses if self._batch else responses[0])


def respond(message: bytes, methods: Mapping[str, Method], role: Role = Role.OPERATE) -> bytes | None:
    """Return the response to a message; None for a notification (a request without id)."""
    return RequestMessage(message).respond(methods, role)


def parse_json(message: bytes) -> Any:
    """Return the JSON value of a message; RpcError for anything else, numbers that are not finite included."""
    if len(message) > MAX_BYTES:
        raise RpcError(INVALID_REQUEST, f"{len(message)} bytes, a request has at most {MAX_BYTES}")
    try:
        return json.loads(message.decode("utf-8"), parse_constant=_finite, parse_float=_finite)
    except (ValueError, RecursionError) as error:
        raise RpcError(PARSE_ERROR, f"not JSON: {type(error).__name__}") from error


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(text)
    return value


def _response(request: Any, call: Callable[[dict[str, Any]], Any]) -> dict[str, Any] | None:
    request_id = None
    try:
        check_request(request)
        request_id = request.get("id")
        response = {"jsonrpc": "2.0", "id": request_id, "result": call(request)}
    except RpcError as error:
        response = _error_response(request_id, error)
        if error.code == INVALID_REQUEST:
            return response
    return response if "id" in request else None


def check_request(request: Any) -> None:
    """Raise RpcError unless a value is a JSON-RPC 2.0 request."""
    if not isinstance(request, dict) or request.get("jsonrpc") != "2.0":
        raise RpcError(INVALID_REQUEST, 'not a JSON-RPC 2.0 request: "jsonrpc": "2.0" is missing')
    request_id = request.get("id")
    valid_id = isinstance(request_id, str | int | float | None) and not isinstance(request_id, bool)
    if not isinstance(request.get("method"), str) or not valid_id:
        raise RpcError(INVALID_REQUEST, "a request has a string as method, and a string or number as id")


def _call(request: dict[str, Any], methods: Mapping[str, Method], role: Role) -> Any:
    name = request["method"]
    method = methods.get(name)
    if method is None:
        raise RpcError(METHOD_NOT_FOUND, f"there is no method {name!r:.60}; there are {', '.join(sorted(methods))}")
    if method.role is Role.OPERATE and role is not Role.OPERATE:
        raise RpcError(FORBIDDEN, f"{name} needs the role operate, this key has the role {role}")
    params = _named_params(request.get("params", {}), method)
    try:
        return method(params)
    except RpcError:
        raise
    except Exception as error:
        log.exception("control: %s failed", name)
        raise RpcError(INTERNAL_ERROR, f"{name} failed: {type(error).__name__}: {error}") from error


def _named_params(params: Any, method: Method) -> dict[str, Any]:
    if isinstance(params, list) and len(params) <= len(method.params):
        return dict(zip(method.params, params, strict=False))
    if not isinstance(params, dict):
        known = ", ".join(method.params) or "none"
        raise RpcError(INVALID_PARAMS, f"params must be an object, or a list of at most these: {known}")
    return params


def _error_response(request_id: Any, error: RpcError) -> dict[str, Any]:
    return {"jsonrpc": "2.0", "id": request_id, "error": error.as_object()}


def _encoded(response: Any) -> bytes:
    try:
        text = json.dumps(response, allow_nan=False)
    except ValueError:
        text = json.dumps(_without_nan(response), allow_nan=False)
    if len(text) > MAX_ANSWER_BYTES:
        request_id = response.get("id") if isinstance(response, dict) else None
        too_long = RpcError(INTERNAL_ERROR, f"the answer has {len(text)} bytes, limit {MAX_ANSWER_BYTES}; ask for less")
        text = json.dumps(_error_response(request_id, too_long))
    return text.encode()


def _without_nan(value: Any) -> Any:
    """Return a value with null for numbers that JSON cannot represent."""
    if isinstance(value, dict):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
