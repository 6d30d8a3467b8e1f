"""The pixels of an output come byte by byte, whatever happens to the server before and after."""

from __future__ import annotations

import os
import signal

import numpy as np
import pytest

from sim.box.output_grabber import DisplayLost, Grabber, Rectangle
from sim.box.xserver import XServer
from tests.open_files import open_files
from tests.sim.box.painter import Painter


def random_image(width: int, height: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def test_every_byte_of_an_output_and_none_of_its_neighbour(server: XServer) -> None:
    painter = Painter(server.display)
    with Grabber(server.display, "DUMMY0") as desktop, Grabber(server.display, "DUMMY1") as projector:
        for seed in range(3):
            left, right = random_image(320, 240, seed), random_image(160, 128, seed + 10)
            painter.paint(left)
            painter.paint(right, x=320)
            assert np.array_equal(desktop.grab(), left)
            assert np.array_equal(projector.grab(), right)
        kept, before = projector.grab(), right.copy()
        painter.paint(random_image(160, 128, 99), x=320)
        projector.grab()
        assert np.array_equal(kept, before)
        with Grabber(server.display, Rectangle(10, 20, 64, 48)) as part:
            assert np.array_equal(part.grab(), left[20:68, 10:74])
    painter.close()


def test_a_server_that_dies_is_named_and_found_again(server: XServer) -> None:
    grabber = Grabber(server.display, "DUMMY1")
    grabber.grab()
    server.kill()
    with pytest.raises(DisplayLost, match="the X server has ended"):
        grabber.grab()
    with pytest.raises(DisplayLost, match="no X server accepts a connection"):
        grabber.grab()
    server.restart()
    image = random_image(160, 128)
    painter = Painter(server.display)
    painter.paint(image, x=320)
    assert np.array_equal(grabber.grab(), image)
    grabber.close()
    painter.close()


def test_a_server_that_hangs_holds_nothing_up(server: XServer) -> None:
    grabber = Grabber(server.display, "DUMMY1", timeout_s=0.2)
    grabber.grab()
    os.kill(server.pid, signal.SIGSTOP)
    try:
        with pytest.raises(DisplayLost, match=r"no answer within 0\.2 s"):
            grabber.grab()
    finally:
        os.kill(server.pid, signal.SIGCONT)
    assert grabber.grab().shape == (128, 160, 3)
    grabber.close()


def test_a_missing_output_is_named_with_the_available_ones(server: XServer) -> None:
    with Grabber(server.display, "HDMI-1") as grabber, pytest.raises(DisplayLost, match=r"there are: DUMMY0, DUMMY1"):
        grabber.grab()


def test_connecting_again_and_again_leaves_nothing_open(server: XServer) -> None:
    with Grabber(server.display, "DUMMY1") as grabber:
        grabber.grab()
        before = open_files()
        for _ in range(8):
            grabber.close()
            grabber.grab()
        assert open_files() == before


@pytest.mark.parametrize("size", [(0, 10), (10, 0), (1 << 20, 1 << 20)])
def test_sizes_are_bounded(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match="rectangle"):
        Rectangle(0, 0, *size)
