"""Messages between the daemon and a camera's process: JSON of bounded size, one message a datagram."""

from __future__ import annotations

import socket
from typing import Any, Literal

import msgspec

from drivers.protocols import Side

MAX_MESSAGE = 60_000
"""Bytes of one message; longer ones are an error of the sender and are not sent."""


class Configure(msgspec.Struct, tag="configure", forbid_unknown_fields=True):
    """The camera to create: ``module:function`` called with (side, options, base_dir)."""

    target: str
    side: Side
    options: dict[str, Any]
    base_dir: str
    slots: int
    parent: int


class Command(msgspec.Struct, tag="command", forbid_unknown_fields=True):
    """Open the camera, start or stop it, or close it and end; answered by Done or Failed of the same number."""

    number: int
    action: Literal["open", "start", "stop", "close"]


class FrameTaken(msgspec.Struct, tag="frame_taken", forbid_unknown_fields=True):
    """The daemon has taken the frame of a slot; ``kept``: the slot is still in use, until SlotReleased."""

    slot: int
    kept: bool


class SlotReleased(msgspec.Struct, tag="slot_released", forbid_unknown_fields=True):
    """The daemon no longer uses the slot."""

    slot: int


class Done(msgspec.Struct, tag="done", forbid_unknown_fields=True):
    """A command was executed."""

    number: int


class Opened(msgspec.Struct, tag="opened", forbid_unknown_fields=True):
    """The camera is open; this message carries the shared memory as a file descriptor."""

    number: int
    model: str
    serial: str
    size: tuple[int, int]
    encoding: str
    exposure_us: float
    notes: tuple[str, ...]
    slot_bytes: int
    slots: int


class Failed(msgspec.Struct, tag="failed", forbid_unknown_fields=True):
    """A command failed, or (number -1) the camera was lost while it acquired."""

    number: int
    kind: Literal["lost", "refused", "driver"]
    message: str


class FrameReady(msgspec.Struct, tag="frame_ready", forbid_unknown_fields=True):
    """A slot holds a new frame."""

    slot: int
    trigger: int
    t_exposure_ns: int
    t_host_ns: int
    encoding: str
    shape: tuple[int, ...]
    wide: bool
    exposure_us: float
    t_device_ns: int | None
    frame_id: int | None


ToChild = Configure | Command | FrameTaken | SlotReleased
ToParent = Done | Opened | Failed | FrameReady

_encoder = msgspec.json.Encoder()
_to_child: msgspec.json.Decoder[ToChild] = msgspec.json.Decoder(ToChild)
_to_parent: msgspec.json.Decoder[ToParent] = msgspec.json.Decoder(ToParent)


def pair() -> tuple[socket.socket, socket.socket]:
    """Create a connection that preserves message boundaries and order and reports the end of the other side."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def encode(message: ToChild | ToParent) -> bytes:
    """Encode a message as a datagram; ValueError when it is too long."""
    data = _encoder.encode(message)
    if len(data) > MAX_MESSAGE:
        raise ValueError(f"a message of {len(data)} bytes to or from the camera's process; at most {MAX_MESSAGE}")
    return data


def decode_for_child(data: bytes) -> ToChild:
    """Decode a message of the daemon."""
    return _to_child.decode(data)


def decode_for_parent(data: bytes) -> ToParent:
    """Decode a message of the camera's process."""
    return _to_parent.decode(data)
