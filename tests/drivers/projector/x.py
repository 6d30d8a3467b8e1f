"""A second pair of eyes: what an X server shows, read through a pure Python client that the driver does not use."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from Xlib import X
from Xlib.display import Display
from Xlib.error import BadWindow

from sim.box.xserver import Head, XServer, XServerError

DESKTOP, PROJECTOR = Head(640, 480), Head(320, 256, 59.94)


def start(server: XServer) -> XServer:
    """Start; where there is no X server, skip with the reason, in CI fail."""
    try:
        server.start()
    except XServerError as error:
        if os.environ.get("CI", "").lower() in ("1", "true", "yes"):
            pytest.fail(f"{error}; run: tools/system-packages x11")
        pytest.skip(str(error))
    return server


@contextmanager
def client(server: XServer) -> Iterator[Display]:
    """A connection of python-xlib."""
    display = Display(server.display)
    try:
        yield display
    finally:
        display.close()


def grab(server: XServer, head: int) -> NDArray[np.uint8]:
    """What an output shows, (H, W, 3)."""
    left, wanted = sum(other.width for other in server.heads[:head]), server.heads[head]
    with client(server) as display:
        root = display.screen().root
        data = root.get_image(left, 0, wanted.width, wanted.height, X.ZPixmap, 0xFFFFFFFF).data
    return np.frombuffer(data, np.uint8).reshape(wanted.height, wanted.width, 4)[:, :, 2::-1]


def top_window(display: Display) -> Any:
    """The topmost window on the screen, which is the projector's while it is open; None if there is none."""
    for window in reversed(display.screen().root.query_tree().children):
        with suppress(BadWindow):  # it may be destroyed between the two requests
            if window.get_attributes().map_state == X.IsViewable:
                return window
    return None


def crtc(display: Display, output: str) -> int:
    """The CRTC of an output."""
    resources = display.screen().root.xrandr_get_screen_resources_current()
    for number in resources.outputs:
        info = display.xrandr_get_output_info(number, resources.config_timestamp)
        if info.name == output:
            return int(info.crtc)
    raise AssertionError(f"no output {output}")


def set_mode(server: XServer, output: str, mode: str | None) -> None:
    """Give an output another mode by name, or switch it off."""
    left = sum(head.width for head in server.heads[: int(output.removeprefix("DUMMY"))])
    change = ["--mode", mode, "--pos", f"{left}x0"] if mode is not None else ["--off"]
    command = ["xrandr", "--output", output, *change]
    done = subprocess.run(command, env=server.environment(), capture_output=True, text=True, timeout=30, check=False)
    assert done.returncode == 0, done.stderr


def gamma(server: XServer, output: str) -> NDArray[np.int64]:
    """Red, green and blue of an output's gamma table, (3, N)."""
    with client(server) as display:
        table = display.xrandr_get_crtc_gamma(crtc(display, output))
    return np.array([table.red, table.green, table.blue])


def bend_gamma(server: XServer, output: str, exponent: float = 2.2) -> NDArray[np.int64]:
    """Load a gamma table that is not linear; the table."""
    with client(server) as display:
        number = crtc(display, output)
        size = display.xrandr_get_crtc_gamma_size(number).size
        values = [round(65535 * (k / (size - 1)) ** exponent) for k in range(size)]
        display.xrandr_set_crtc_gamma(number, size, values, values, values)
        display.sync()
    return np.array([values] * 3)


def noise(server: XServer, head: int, seed: int = 0) -> NDArray[np.uint8]:
    """An image of an output's size in which every pixel is different."""
    size = server.heads[head]
    return np.random.default_rng(seed).integers(0, 256, (size.height, size.width, 3), dtype=np.uint8)
