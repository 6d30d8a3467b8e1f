"""Error codes of control, and the limits of stream and control."""

from __future__ import annotations

from fringed import wire

VERSION = 1

ERRORS = {
    -32700: "the message is no JSON",
    -32600: "not a request: over 64 KiB, no jsonrpc, an id of another type, an empty or too long batch",
    -32601: "no such method",
    -32602: "a parameter is invalid; data.path names the setting or parameter",
    -32603: "the daemon failed unexpectedly, or the answer is over its limit",
    -32000: "the daemon refuses or fails, with the reason; a refused reload lists data.restart and data.live",
    -32001: "the role of the key does not allow the method",
    -32002: "busy: eight background requests wait; try again later",
}
"""Codes of JSON-RPC and of the daemon."""

LIMITS = {
    "stream: header, bytes": wire.MAX_HEADER_BYTES,
    "stream: topic, ASCII characters": wire.MAX_TOPIC_BYTES,
    "stream: parts of a message": wire.MAX_PARTS,
    "stream: decoded part, bytes": wire.MAX_PART_BYTES,
    "stream: dimensions of a part": 4,
    "stream: width and height of a cloud, pixels": 65535,
    "stream: subscription, bytes": 64,
    "stream: messages that wait for a slow subscriber": 8,
    "control: request, bytes": 64 * 1024,
    "control: answer, bytes": 1024 * 1024,
    "control: requests in a batch (this machine only)": 32,
    "control: background requests that wait": 8,
}
