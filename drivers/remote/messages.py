"""What the daemon and a camera's process say to each other: small JSON messages, one a datagram, of bounded size."""

from __future__ import annotations

import socket
from typing import Any, Literal

import msgspec

from drivers.protocols import Side

MAX_MESSAGE = 60_000
"""Bytes of one message; longer ones are a mistake of the sender and are not sent."""


class Configure(msgspec.Struct, tag="configure", forbid_unknown_fields=True):
    """Which camera to make: ``module:function`` taking (side, options, base_dir)."""

    target: str
    side: Side
    options: dict[str, Any]
    base_dir: str
    slots: int
    parent: int


class Order(msgspec.Struct, tag="order", forbid_unknown_fields=True):
    """Open the camera, start or stop it, or close it and end; answered by Done or Failed of the same number."""

    number: int
    what: Literal["open", "start", "stop", "close"]


class Took(msgspec.Struct, tag="took", forbid_unknown_fields=True):
    """The frame of a slot was taken over; ``kept``: the slot is still looked at and comes back with Returned."""

    slot: int
    kept: bool


class Returned(msgspec.Struct, tag="returned", forbid_unknown_fields=True):
    """Nobody looks at the slot any more."""

    slot: int


class Done(msgspec.Struct, tag="done", forbid_unknown_fields=True):
    """An order was carried out."""

    number: int


class Opened(msgspec.Struct, tag="opened", forbid_unknown_fields=True):
    """The camera is open; the shared memory comes with this message as a file descriptor."""

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
    """An order failed, or (number -1) the camera was lost while it measured."""

    number: int
    kind: Literal["lost", "refused", "driver"]
    message: str


class Ready(msgspec.Struct, tag="ready", forbid_unknown_fields=True):
    """A frame stands in a slot."""

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


ToChild = Configure | Order | Took | Returned
ToParent = Done | Opened | Failed | Ready

_encoder = msgspec.json.Encoder()
_to_child: msgspec.json.Decoder[ToChild] = msgspec.json.Decoder(ToChild)
_to_parent: msgspec.json.Decoder[ToParent] = msgspec.json.Decoder(ToParent)


def pair() -> tuple[socket.socket, socket.socket]:
    """Two ends of a connection that keeps messages apart and in order and tells when the other end died."""
    return socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)


def encode(message: ToChild | ToParent) -> bytes:
    """The message's datagram; ValueError when it is too long."""
    data = _encoder.encode(message)
    if len(data) > MAX_MESSAGE:
        raise ValueError(f"a message of {len(data)} bytes to or from the camera's process; at most {MAX_MESSAGE}")
    return data


def decode_for_child(data: bytes) -> ToChild:
    """What the daemon said."""
    return _to_child.decode(data)


def decode_for_parent(data: bytes) -> ToParent:
    """What the camera's process said."""
    return _to_parent.decode(data)
