"""What is shown is what was asked for, byte for byte, on the right output, and when it was out."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from drivers.errors import DriverError, SettingRefused
from drivers.projector import OutputProjector, images
from sim.box.xserver import Head, XServer
from tests.drivers.projector import x
from tools.waiting import wait_until

Make = Callable[..., OutputProjector]


@pytest.mark.parametrize("head", [pytest.param(0, marks=pytest.mark.long), 1], ids=["DUMMY0", "DUMMY1"])
def test_every_image_is_on_its_output_byte_for_byte(server: XServer, projector: Make, head: int) -> None:
    size, other = server.heads[head], x.grab(server, 1 - head)
    shown = projector(server, output=f"DUMMY{head}")
    info = shown.open()
    assert (info.output, info.size) == (f"DUMMY{head}", (size.width, size.height))
    assert info.refresh_hz == pytest.approx(size.refresh_hz, abs=0.01)
    assert not x.grab(server, head).any(), "an open projector is black"
    ramp = np.zeros((size.height, size.width, 3), np.uint8)
    ramp[:, :256] = np.arange(256)[:, None]
    for image in (x.noise(server, head), ramp, images.alignment(info.size), images.plain(info.size, 255)):
        shown.show(image)
        assert shown.problem() == ""
        assert np.array_equal(x.grab(server, head), image)
    assert np.array_equal(x.grab(server, 1 - head), other), "the other output is left alone"
    shown.close()
    assert not x.grab(server, head).any()
    with x.client(server) as display:
        assert x.top_window(display) is None


def test_a_window_manager_does_not_move_it(own_server: XServer, projector: Make) -> None:
    if shutil.which("openbox") is None:
        assert not os.environ.get("CI"), "openbox is missing; run: tools/system-packages x11"
        pytest.skip("openbox is not installed; run: tools/system-packages x11")
    manager = subprocess.Popen(["openbox"], env=own_server.environment(), stderr=subprocess.DEVNULL)
    try:
        with x.client(own_server) as display:
            root, atom = display.screen().root, display.intern_atom("_NET_SUPPORTING_WM_CHECK")
            wait_until(lambda: root.get_full_property(atom, 0) is not None, what="openbox is there")
        shown = projector(own_server)
        shown.open()
        shown.show(x.noise(own_server, 1))
        assert np.array_equal(x.grab(own_server, 1), x.noise(own_server, 1)) and shown.problem() == ""
        shown.close()
    finally:
        manager.terminate()
        manager.wait(20)


def test_two_projectors_of_two_sizes_show_side_by_side(server: XServer, projector: Make) -> None:
    both = [projector(server, output="DUMMY0"), projector(server, output="DUMMY1")]
    for head, shown in enumerate(both):
        shown.open()
        shown.show(x.noise(server, head))
    for head, shown in enumerate(both):
        assert np.array_equal(x.grab(server, head), x.noise(server, head)) and shown.problem() == ""


def test_a_server_with_one_output_will_do(projector: Make) -> None:
    server = x.start(XServer([Head(640, 480)], kind="xvfb"))
    try:
        shown = projector(server, output="screen")
        assert shown.open().refresh_hz == 0
        assert any("no native resolution" in note for note in shown.notes)
        shown.show(x.noise(server, 0))
        assert np.array_equal(x.grab(server, 0), x.noise(server, 0))
        shown.close()
    finally:
        server.stop()


def test_flips_are_timed_by_the_vertical_blank(server: XServer, projector: Make) -> None:
    shown = projector(server)
    shown.open()
    assert shown.measured_refresh_hz is None
    flips = []
    for seed in range(6):
        flip = shown.show(x.noise(server, 1, seed))
        assert flip is not None
        flips.append(flip)
    assert {flip.source for flip in flips} == {"vblank"}, "the server presents no OpenGL itself, but has a clock"
    assert all(b.msc > a.msc and b.t_monotonic_ns > a.t_monotonic_ns for a, b in pairwise(flips))

    def measures_60_hz() -> bool:
        shown.show(x.noise(server, 1))
        return shown.measured_refresh_hz == pytest.approx(60, rel=0.03)

    # The dummy driver's clock is a timer that a busy machine delays: by 7 ms at the first flip, 6 % of 100 ms.
    wait_until(measures_60_hz, what="the refresh rate is that of the vertical blanks")


def test_a_sequence_goes_on_by_itself_and_its_last_image_stays(server: XServer, projector: Make) -> None:
    shown = projector(server)
    shown.open()
    sequence = [x.noise(server, 1, seed) for seed in range(3)]
    shown.show_sequence(sequence, hold_frames=2)
    wait_until(lambda: np.array_equal(x.grab(server, 1), sequence[2]), what="the last image is out")
    shown.show_sequence(sequence, hold_frames=15, loop=True)
    for image in [*sequence, sequence[0]]:
        wait_until(lambda wanted=image: np.array_equal(x.grab(server, 1), wanted), what="each image comes")
    shown.show(sequence[1])
    assert np.array_equal(x.grab(server, 1), sequence[1]) and shown.problem() == ""


def test_images_that_do_not_fit_are_refused(server: XServer, projector: Make) -> None:
    shown = projector(server)
    image = x.noise(server, 1)
    with pytest.raises(DriverError, match=r"open\(\) comes first"):
        shown.show(image)
    shown.open()
    for wrong in (image[:-1], image[..., 0], image.astype(np.uint16)):
        with pytest.raises(SettingRefused, match=r"does not fit output DUMMY1, expected \(256, 320, 3\) uint8"):
            shown.show(wrong)
    for count, hold_frames in ((0, 1), (65, 1), (1, 0)):
        with pytest.raises(SettingRefused, match="expected 1 to 64"):
            shown.show_sequence([image] * count, hold_frames=hold_frames)
    assert shown.problem() == ""
