"""Packets between the driver and its window: whole, bounded, and nothing else is taken for one."""

from __future__ import annotations

import os
import socket
from collections.abc import Iterator

import msgspec
import numpy as np
import pytest

from drivers.projector import messages
from drivers.projector.messages import Heartbeat, Opened, Setup, Show, Shown
from drivers.projector.options import ProjectorOptions
from drivers.projector.x11.detected_output import DetectedOutput

Pair = tuple[socket.socket, socket.socket]


@pytest.fixture
def pair() -> Iterator[Pair]:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        yield ours, theirs


def test_what_is_sent_comes_back(pair: Pair) -> None:
    output = DetectedOutput(name="HDMI-1", connected=True, preferred_size=(8, 8))
    for message in (
        Opened(output=output, notes=("a", "b"), gamma_before=bytes(6 * 256)),
        Shown(serial=7, t_monotonic_ns=1 << 60, msc=1 << 40, source="vblank"),
        Heartbeat(problem="covered", late=3),
    ):
        messages.send(pair[0], message)
        assert messages.receive_from_window(pair[1]) == message
    setup = Setup(options=ProjectorOptions(output="x", size=(4, 4)), display=":0", gamma_before=b"\0\xff")
    messages.send(pair[0], setup)
    assert messages.receive_in_window(pair[1]) == (setup, None)


def test_images_come_whole_and_read_only(pair: Pair) -> None:
    images = list(np.random.default_rng(0).integers(0, 256, (3, 5, 7, 3), dtype=np.uint8))
    memfd = messages.pack_images([images[0], np.asfortranarray(images[1]), images[2]])
    show = Show(serial=1, count=3, width=7, height=5)
    messages.send(pair[0], show, memfd)
    os.close(memfd)
    received = messages.receive_in_window(pair[1])
    assert received is not None and received[0] == show and received[1] is not None
    taken = messages.unpack_images(received[1], show)
    assert np.array_equal(taken, images) and not taken.flags.writeable


@pytest.mark.parametrize(("count", "width", "height"), [(1, 7, 5), (2, 7, 6), (65, 1, 1), (0, 7, 5), (1, 9000, 1)])
def test_images_of_another_size_than_announced_are_refused(count: int, width: int, height: int) -> None:
    memfd = messages.pack_images([np.zeros((5, 7, 3), np.uint8)] * 2)
    with pytest.raises(ValueError, match="are not in the"):
        messages.unpack_images(memfd, Show(serial=1, count=count, width=width, height=height))
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(memfd)


def test_the_end_is_reported_and_invalid_data_is_an_error(pair: Pair) -> None:
    pair[0].send(b'{"type":"shout"}')
    with pytest.raises(msgspec.ValidationError):
        messages.receive_from_window(pair[1])
    pair[0].close()
    assert messages.receive_from_window(pair[1]) is None


def test_a_message_that_is_too_long_is_not_sent(pair: Pair) -> None:
    with pytest.raises(ValueError, match="at most"):
        messages.send(pair[0], Heartbeat(problem="x" * messages.PACKET_LIMIT))


def test_a_reader_that_does_not_read_blocks_nobody(pair: Pair) -> None:
    with pytest.raises(BlockingIOError):
        for _ in range(10_000):
            messages.send(pair[0], Heartbeat(), wait=False)
