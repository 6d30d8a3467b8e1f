"""JSON-RPC 2.0: bytes in, bytes out. Whatever comes in, the answer is a proper response or nothing."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping
from typing import Any

log = logging.getLogger("fringed.control")

MAX_BYTES = 64 * 1024

PARSE_ERROR, INVALID_REQUEST, METHOD_NOT_FOUND, INVALID_PARAMS, INTERNAL_ERROR = -32700, -32600, -32601, -32602, -32603
FAILED = -32000

Method = Callable[[dict[str, Any]], Any]


class RpcError(Exception):
    """An error for the caller; ``path`` names the setting that it is about."""

    def __init__(self, code: int, message: str, path: str | None = None) -> None:
        super().__init__(message)
        self.code, self.message, self.path = code, message, path

    def as_object(self) -> dict[str, Any]:
        """The ``error`` member of a response."""
        data = {} if self.path is None else {"data": {"path": self.path}}
        return {"code": self.code, "message": self.message} | data


def answer(message: bytes, methods: Mapping[str, Method]) -> bytes | None:
    """The response to a request; None for a notification (a request without id)."""
    request_id: Any = None
    try:
        request = _parsed(message)
        request_id = request.get("id")
        result = _called(request, methods)
        response = {"jsonrpc": "2.0", "id": request_id, "result": result}
        return None if "id" not in request else json.dumps(response).encode()
    except RpcError as error:
        failed = {"jsonrpc": "2.0", "id": request_id, "error": error.as_object()}
        return json.dumps(failed).encode()


def _parsed(message: bytes) -> dict[str, Any]:
    if len(message) > MAX_BYTES:
        raise RpcError(INVALID_REQUEST, f"{len(message)} bytes, a request has at most {MAX_BYTES}")
    try:
        request = json.loads(message.decode("utf-8"), parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise RpcError(PARSE_ERROR, f"not JSON: {type(error).__name__}") from error
    if isinstance(request, list):
        raise RpcError(INVALID_REQUEST, "batches are not answered; send one request at a time")
    if not isinstance(request, dict) or request.get("jsonrpc") != "2.0":
        raise RpcError(INVALID_REQUEST, 'not a JSON-RPC 2.0 request: "jsonrpc": "2.0" is missing')
    if not isinstance(request.get("method"), str) or not isinstance(request.get("id"), str | int | float | None):
        raise RpcError(INVALID_REQUEST, "a request has a text as method, and a text or number as id")
    return request


def _no_constant(name: str) -> float:
    raise ValueError(name)


def _called(request: dict[str, Any], methods: Mapping[str, Method]) -> Any:
    name, params = request["method"], request.get("params", {})
    method = methods.get(name)
    if method is None:
        raise RpcError(METHOD_NOT_FOUND, f"there is no method {name!r:.60}; there are {', '.join(sorted(methods))}")
    if not isinstance(params, dict):
        raise RpcError(INVALID_PARAMS, "params must be an object with named values")
    try:
        return method(params)
    except RpcError:
        raise
    except Exception as error:
        log.exception("control: %s failed", name)
        raise RpcError(INTERNAL_ERROR, f"{name} failed: {type(error).__name__}: {error}") from error
