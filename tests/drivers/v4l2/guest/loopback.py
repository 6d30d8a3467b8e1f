"""Two loopback cameras: known images written on one end, read by the driver on the other, paired by the daemon."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.live.acquisition.pairer import Pairer
from daemon.live.acquisition.pairing_events import PairingSettings
from daemon.live.items import Pair
from drivers.protocols import SIDES, Side
from drivers.v4l2 import discover
from drivers.v4l2 import structs as v
from drivers.v4l2.kernel import LinuxKernel
from tests.drivers.v4l2.guest.vivid_devices import DEADLINE_S, acquiring, read
from tools.waiting import wait_until

NODES: dict[Side, str] = {"left": "/dev/video40", "right": "/dev/video41"}
SIZE = (320, 240)
_VIDEO_OUTPUT = 2


@contextmanager
def output(node: str, fourcc: str, size_bytes: int) -> Iterator[int]:
    """The writing end of a loopback device."""
    kernel = LinuxKernel()
    fd = kernel.open(node)
    try:
        form = v.Format(type=_VIDEO_OUTPUT)
        pix = form.fmt.pix
        (pix.width, pix.height), pix.pixelformat, pix.field = SIZE, v.fourcc(fourcc), v.FIELD_NONE
        pix.sizeimage = size_bytes
        kernel.ioctl(fd, v.S_FMT, form)
        yield fd
    finally:
        os.close(fd)


def grey(number: int) -> NDArray[np.uint8]:
    return np.random.default_rng(number).integers(0, 256, SIZE[::-1], dtype=np.uint8)


EARLIER = np.full(SIZE[::-1], 77, np.uint8).tobytes()
"""Written before a camera starts; it may or may not get it."""


def test_discovery_names_the_loopback_cameras() -> None:
    with output(NODES["left"], "GREY", 320 * 240) as fd:
        os.write(fd, EARLIER)
        assert {entry.node: entry.card for entry in discover()}[NODES["left"]] == "loop-left"


def test_every_byte_arrives() -> None:
    with output(NODES["left"], "GREY", 320 * 240) as fd:
        os.write(fd, EARLIER)
        with acquiring(NODES["left"], format="GREY", size=SIZE, buffers=4) as made:
            for number in range(20):
                os.write(fd, grey(number).tobytes())
                wanted = grey(number)
                image = read(made).image
                if number == 0 and image.tobytes() == EARLIER:
                    image = read(made).image
                assert np.array_equal(image, wanted), f"image {number} is not the one that was written"


def test_pairs_hold_images_of_the_same_moment() -> None:
    settings = PairingSettings(tolerance_ns=10**8, max_wait_ns=60 * 10**9, stale_ns=60 * 10**9)
    pairer, pairs = Pairer(settings), []
    with (
        output(NODES["left"], "GREY", 320 * 240) as left,
        output(NODES["right"], "GREY", 320 * 240) as right,
    ):
        ends = {"left": left, "right": right}
        for fd in ends.values():
            os.write(fd, EARLIER)
        with (
            acquiring(NODES["left"], side="left", format="GREY", size=SIZE) as left_camera,
            acquiring(NODES["right"], side="right", format="GREY", size=SIZE) as right_camera,
        ):
            cameras = {"left": left_camera, "right": right_camera}
            for number in range(60):
                if len(pairs) >= 6:
                    break
                time.sleep(0.25)  # the triggers' interval: pairing by time needs more than twice its tolerance
                for i, side in enumerate(SIDES):
                    os.write(ends[side], grey(1000 * i + number).tobytes())
                for i, side in enumerate(SIDES):
                    frame = read(cameras[side])
                    while not np.array_equal(frame.image, grey(1000 * i + number)):
                        frame = read(cameras[side])
                    pairs += [event for event in pairer.feed(frame) if isinstance(event, Pair)]
    assert len(pairs) >= 6
    for pair in pairs:
        number = next(n for n in range(60) if np.array_equal(pair.left.image, grey(n)))
        assert np.array_equal(pair.right.image, grey(1000 + number))


def test_jpeg_is_decoded_and_a_broken_one_counted() -> None:
    column = np.linspace(0, 255, SIZE[0]).astype(np.uint8)
    image = np.stack(np.broadcast_arrays(column, column[::-1], np.uint8(90)), -1)[None].repeat(SIZE[1], 0)
    whole = cv2.imencode(".jpg", image[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 95])[1].tobytes()
    with output(NODES["left"], "MJPG", 320 * 240) as fd:
        os.write(fd, whole)
        with acquiring(NODES["left"], format="MJPG", size=SIZE) as made:
            os.write(fd, whole)
            assert np.abs(read(made).image.astype(int) - image).mean() < 4
            os.write(fd, whole[: len(whole) // 2])
            wait_until(
                lambda: not made.read(0.1) and made.health().counters["corrupt_jpeg"], what="the broken one is counted"
            )
            os.write(fd, whole)
            assert np.abs(read(made).image.astype(int) - image).mean() < 4


def test_waiting_for_a_frame_lets_other_threads_run() -> None:
    with output(NODES["left"], "GREY", 320 * 240) as fd:
        os.write(fd, EARLIER)
        with acquiring(NODES["left"], format="GREY", size=SIZE) as made:
            while made.read(0.2) is not None:
                pass
            for number in range(5):
                waiting = threading.Event()
                thread = threading.Thread(target=write_when, args=(waiting, fd, number))
                thread.start()
                waiting.set()
                frame = read(made)  # None after the time-out, if waiting kept the interpreter to itself
                thread.join()
                assert np.array_equal(frame.image, grey(number))


def write_when(waiting: threading.Event, fd: int, number: int) -> None:
    waiting.wait(DEADLINE_S)
    os.write(fd, grey(number).tobytes())


def test_more_buffers_than_the_device_has_are_not_waited_for() -> None:
    with output(NODES["left"], "GREY", 320 * 240) as fd:
        os.write(fd, EARLIER)
        with acquiring(NODES["left"], format="GREY", size=SIZE, buffers=32) as made:
            os.write(fd, grey(1).tobytes())
            assert read(made).image.shape == (240, 320)
