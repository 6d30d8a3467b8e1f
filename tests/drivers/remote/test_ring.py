"""The shared memory: what the daemon believes of it, and what it does not."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from drivers.errors import DriverError
from drivers.protocols import CameraHealth
from drivers.remote import messages
from drivers.remote.messages import FrameReady
from drivers.remote.outbox import WINDOW, Outbox
from drivers.remote.ring import RingReader, RingWriter, added


def test_what_is_written_is_read() -> None:
    writer = RingWriter(4, 100)
    reader = RingReader(writer.fd, 4, writer.slot_bytes)
    writer.slot(2, (5, 10), np.dtype(np.uint16))[...] = 1234
    assert (reader.image(2, (5, 10), wide=True) == 1234).all()
    assert not reader.image(2, (5, 10), wide=True).flags.writeable
    os.close(writer.fd)


@pytest.mark.parametrize(("index", "shape"), [(-1, (2, 2)), (4, (2, 2)), (0, (4096, 2)), (0, (-1, -1))])
def test_images_that_cannot_be_are_refused(index: int, shape: tuple[int, ...]) -> None:
    writer = RingWriter(4, 100)
    reader = RingReader(writer.fd, 4, writer.slot_bytes)
    with pytest.raises(DriverError):
        reader.image(index, shape, wide=False)
    os.close(writer.fd)


@pytest.mark.parametrize(("slots", "slot_bytes"), [(4, 8192), (2, 4096), (4, 100), (257, 4096), (4, 1 << 40)])
def test_memory_of_another_size_is_refused(slots: int, slot_bytes: int) -> None:
    writer = RingWriter(4, 4096)
    with pytest.raises(DriverError):
        RingReader(writer.fd, slots, slot_bytes)
    os.close(writer.fd)


def test_the_memory_can_neither_shrink_nor_grow() -> None:
    writer = RingWriter(4, 4096)
    for size in (0, 1 << 20):
        with pytest.raises(PermissionError):
            os.ftruncate(writer.fd, size)
    os.close(writer.fd)


def test_the_heartbeat_is_read_whole_while_it_is_written() -> None:
    """A half-written heartbeat would mean that the camera's process died hours ago."""
    ours, theirs = socket.socketpair()
    with ours, theirs:
        child = subprocess.Popen([sys.executable, "-c", BEATING, str(theirs.fileno())], pass_fds=[theirs.fileno()])
        try:
            _, fds, _, _ = socket.recv_fds(ours, 1, 1)
            reader = RingReader(fds[0], 4, 4096)
            began_ns = time.monotonic_ns()
            oldest_ns = max(reader.age_ns(began_ns) for _ in range(200_000))
        finally:
            child.kill()
            child.wait()
    os.close(fds[0])
    assert oldest_ns < 60_000_000_000


BEATING = """
import socket, sys
from drivers.remote.ring import RingWriter

writer = RingWriter(4, 100)
writer.heartbeat()
socket.send_fds(socket.socket(fileno=int(sys.argv[1])), [b"x"], [writer.fd])
while True:
    writer.heartbeat()
"""


def test_health_is_never_read_half_written() -> None:
    writer = RingWriter(4, 100)
    reader = RingReader(writer.fd, 4, writer.slot_bytes)
    assert reader.health() == CameraHealth()
    stop = threading.Event()

    def post() -> None:
        k = 0
        while not stop.is_set():
            k += 1
            writer.write_health(CameraHealth(float(k), {f"counter{i}": k for i in range(k % 50)}))

    thread = threading.Thread(target=post)
    thread.start()
    try:
        for _ in range(2000):
            health = reader.health()
            assert set(health.counters.values()) <= {int(health.temperature_c or 0)}
    finally:
        stop.set()
        thread.join()
    os.close(writer.fd)


def test_the_heartbeat_has_an_age() -> None:
    writer = RingWriter(4, 100)
    reader = RingReader(writer.fd, 4, writer.slot_bytes)
    before = time.monotonic_ns()
    writer.heartbeat()
    assert 0 <= reader.age_ns(time.monotonic_ns()) <= time.monotonic_ns() - before
    os.close(writer.fd)


def test_asking_for_memory_again_gives_the_same() -> None:
    announced: list[FrameReady] = []
    writer = RingWriter(3, 64)
    outbox = Outbox(writer, announced.append)
    first = outbox.allocate((8, 8), np.uint8)
    again = outbox.allocate((8, 8), np.uint8)
    assert np.shares_memory(first, again)
    os.close(writer.fd)


def test_no_more_than_the_window_is_announced() -> None:
    announced: list[FrameReady] = []
    writer = RingWriter(6, 64)
    outbox = Outbox(writer, announced.append)
    from tests.drivers.remote.fake import FakeCamera

    camera = FakeCamera("left", {"frames": 100})
    for _ in range(20):
        frame = camera.read(0.0)
        assert frame is not None
        outbox.put(frame)
    assert [ready.trigger for ready in announced] == list(range(WINDOW))
    assert outbox.waiting + WINDOW + outbox.ring_full == 20
    outbox.taken(announced[0].slot, kept=False)
    assert announced[-1].trigger == 20 - outbox.waiting - 1
    os.close(writer.fd)


def test_messages_are_bounded() -> None:
    with pytest.raises(ValueError, match="at most"):
        messages.encode(messages.Failed(1, "lost", "x" * messages.MAX_MESSAGE))


def test_counters_add_up() -> None:
    assert added({"a": 1, "b": 2}, {"b": 3, "c": 4}) == {"a": 1, "b": 5, "c": 4}
