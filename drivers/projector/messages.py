"""Messages between the driver and its window's process: JSON in packets of bounded size, images by memfd."""

from __future__ import annotations

import fcntl
import mmap
import os
import socket
from typing import TypeAlias

import msgspec
import numpy as np
from numpy.typing import NDArray

from drivers.projector.options import SIZE_LIMIT, ProjectorOptions
from drivers.projector.x11.detected_output import DetectedOutput
from drivers.protocols import FlipSource

PACKET_LIMIT = 1 << 17
SEQUENCE_LIMIT = 64
BYTES_LIMIT = 1 << 30


class Setup(msgspec.Struct, tag="setup", frozen=True, kw_only=True):
    """First message to the window; ``gamma_before``: gamma table to restore, from a window process that died."""

    options: ProjectorOptions
    display: str
    gamma_before: bytes = b""


class Show(msgspec.Struct, tag="show", frozen=True, kw_only=True):
    """Show the images in the memfd of this packet.

    Args:
        serial: number that comes back in :class:`Shown`.
        count: images of (height, width, 3) bytes, one after the other.
        hold_frames: vertical blanks that each stays; loop: whether to repeat.
    """

    serial: int
    count: int
    width: int
    height: int
    hold_frames: int = 1
    loop: bool = False


class Close(msgspec.Struct, tag="close", frozen=True):
    """Go dark, restore, end."""


class Opened(msgspec.Struct, tag="opened", frozen=True, kw_only=True):
    """The window is on the output, black."""

    output: DetectedOutput
    notes: tuple[str, ...]
    gamma_before: bytes = b""


class Failed(msgspec.Struct, tag="failed", frozen=True, kw_only=True):
    """The window failed to open, or was lost; ``refused``: a setting must be changed first."""

    reason: str
    refused: bool = False


class Shown(msgspec.Struct, tag="shown", frozen=True, kw_only=True):
    """The image is displayed since ``t_monotonic_ns``, vertical blank number ``msc``."""

    serial: int
    t_monotonic_ns: int
    msc: int
    source: FlipSource


class Heartbeat(msgspec.Struct, tag="heartbeat", frozen=True, kw_only=True):
    """Heartbeat of the window; ``late``: images of sequences that were displayed later than planned."""

    problem: str = ""
    late: int = 0


ToWindow: TypeAlias = Setup | Show | Close
FromWindow: TypeAlias = Opened | Failed | Shown | Heartbeat

_to_window = msgspec.json.Decoder(Setup | Show | Close)
_from_window = msgspec.json.Decoder(Opened | Failed | Shown | Heartbeat)


def send(sock: socket.socket, message: ToWindow | FromWindow, memfd: int | None = None, *, wait: bool = True) -> None:
    """Send one packet, with a file descriptor if there is one.

    Raises:
        OSError: the other side has ended. BlockingIOError: it does not read, and ``wait`` is False.
    """
    packet = msgspec.json.encode(message)
    if len(packet) > PACKET_LIMIT:
        raise ValueError(f"message of {len(packet)} bytes, at most {PACKET_LIMIT} are sent")
    if memfd is None:
        sock.send(packet, 0 if wait else socket.MSG_DONTWAIT)
    else:
        socket.send_fds(sock, [packet], [memfd])


def receive_in_window(sock: socket.socket) -> tuple[ToWindow, int | None] | None:
    """Receive a packet to the window and its file descriptor (closed by the caller); None at the end."""
    packet, memfds, _, _ = socket.recv_fds(sock, PACKET_LIMIT, 1)
    if not packet:
        return None
    return _to_window.decode(packet), memfds[0] if memfds else None


def receive_from_window(sock: socket.socket) -> FromWindow | None:
    """Receive a packet from the window; None at the end."""
    packet = sock.recv(PACKET_LIMIT)
    return _from_window.decode(packet) if packet else None


def pack_images(images: list[NDArray[np.uint8]]) -> int:
    """Write images of one size, (H, W, 3), to a sealed memfd that the caller closes."""
    memfd = os.memfd_create("fringed-images", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    try:
        for image in images:
            view = memoryview(np.ascontiguousarray(image).data).cast("B")
            while view:
                view = view[os.write(memfd, view) :]
        fcntl.fcntl(memfd, fcntl.F_ADD_SEALS, fcntl.F_SEAL_WRITE | fcntl.F_SEAL_SHRINK | fcntl.F_SEAL_GROW)
    except BaseException:
        os.close(memfd)
        raise
    return memfd


def unpack_images(memfd: int, show: Show) -> NDArray[np.uint8]:
    """Return the images of a message, (count, height, width, 3), and close the memfd; ValueError for a wrong size."""
    try:
        size = show.count * show.width * show.height * 3
        valid = 1 <= show.count <= SEQUENCE_LIMIT and 1 <= show.width <= SIZE_LIMIT and 1 <= show.height <= SIZE_LIMIT
        if not valid or size > BYTES_LIMIT or os.fstat(memfd).st_size != size:
            raise ValueError(f"{show.count} images of {show.width}x{show.height} are not in the {size} bytes sent")
        mapped = mmap.mmap(memfd, size, prot=mmap.PROT_READ)
    finally:
        os.close(memfd)
    return np.frombuffer(mapped, np.uint8).reshape(show.count, show.height, show.width, 3)
