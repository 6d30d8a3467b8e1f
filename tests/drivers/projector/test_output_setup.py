"""Outputs that would change pixels are refused by name; what can be mended while it runs is mended."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from Xlib import X

from drivers.errors import DriverError, SettingRefused
from drivers.projector import OutputProjector
from sim.box.xserver import XServer
from tests.drivers.projector import x
from tools.waiting import wait_until

Make = Callable[..., OutputProjector]


@pytest.mark.parametrize(
    ("options", "error", "complaint"),
    [
        ({"output": "HDMI-1"}, DriverError, "output HDMI-1: no such output on this display; there are: DUMMY0, DUMMY1"),
        ({"output": "DUMMY7"}, DriverError, "output DUMMY7 is not connected"),
        ({"display": ":4711"}, DriverError, "X display :4711: no connection"),
        ({"size": (640, 480)}, SettingRefused, "output DUMMY1 is 320x256, expected 640x480"),
        ({"refresh_hz": 60.0}, SettingRefused, "output DUMMY1 refreshes at 59.943 Hz, expected 60 Hz"),
        ({"hook": {"open": [["false"]]}}, DriverError, "'false' ended with 1"),
    ],
)
def test_what_does_not_fit_is_refused_by_name(
    server: XServer, projector: Make, options: dict[str, Any], error: type[Exception], complaint: str
) -> None:
    shown = projector(server, **options)
    with pytest.raises(error, match=complaint):
        shown.open()
    assert "closed" in shown.problem() and shown.window_pid == 0


def test_an_output_that_is_off_or_not_native_is_refused(own_server: XServer, projector: Make) -> None:
    x.set_mode(own_server, "DUMMY1", "640x480")
    with pytest.raises(SettingRefused, match="is 640x480 but the projector's own resolution is 320x256"):
        projector(own_server).open()
    assert projector(own_server, mode="any").open().size == (640, 480)
    x.set_mode(own_server, "DUMMY1", None)
    with pytest.raises(DriverError, match="connected but switched off"):
        projector(own_server).open()


@pytest.fixture
def bent(own_server: XServer) -> Iterator[np.ndarray[Any, Any]]:
    """A gamma table that is not linear on DUMMY1."""
    yield x.bend_gamma(own_server, "DUMMY1")


def test_a_gamma_table_that_is_not_linear_is_refused(
    own_server: XServer, projector: Make, bent: np.ndarray[Any, Any]
) -> None:
    with pytest.raises(SettingRefused, match="output DUMMY1 has a gamma table that is not linear"):
        projector(own_server).open()
    assert np.array_equal(x.gamma(own_server, "DUMMY1"), bent), "a refusal changes nothing"


@pytest.mark.parametrize(
    "killed", [pytest.param(False, marks=pytest.mark.long), True], ids=["in peace", "after a kill"]
)
def test_a_gamma_table_is_reset_and_restored(
    own_server: XServer, projector: Make, bent: np.ndarray[Any, Any], killed: bool
) -> None:
    shown = projector(own_server, gamma="reset")
    shown.open()
    assert any("gamma" in note for note in shown.notes)
    linear = np.linspace(0, 65535, bent.shape[1])
    assert np.abs(x.gamma(own_server, "DUMMY1") - linear).max() < 1
    if killed:
        first = shown.window_pid
        os.kill(first, signal.SIGKILL)
        wait_until(lambda: shown.window_pid not in (0, first) and not shown.problem(), what="the window is back")
        assert np.abs(x.gamma(own_server, "DUMMY1") - linear).max() < 1
    shown.close()
    assert np.array_equal(x.gamma(own_server, "DUMMY1"), bent)


def test_a_gamma_table_that_is_bent_while_running_is_a_problem_or_mended(own_server: XServer, projector: Make) -> None:
    checked = projector(own_server, output="DUMMY0")
    mended = projector(own_server, output="DUMMY1", gamma="reset")
    checked.open()
    mended.open()
    x.bend_gamma(own_server, "DUMMY0")
    x.bend_gamma(own_server, "DUMMY1")
    wait_until(lambda: "gamma table that is not linear" in checked.problem(), what="the problem is reported")
    wait_until(
        lambda: bool(np.abs(np.diff(np.diff(x.gamma(own_server, "DUMMY1")))).max() <= 1), what="the table is linear"
    )
    assert mended.problem() == ""


def test_another_mode_is_a_problem_until_it_is_undone(own_server: XServer, projector: Make) -> None:
    shown, image = projector(own_server), x.noise(own_server, 1)
    shown.open()
    shown.show(image)
    x.set_mode(own_server, "DUMMY1", "640x480")
    wait_until(lambda: "is 640x480 but the projector's own resolution" in shown.problem(), what="the mode is reported")
    x.set_mode(own_server, "DUMMY1", None)
    wait_until(lambda: "switched off" in shown.problem(), what="the output is reported")
    x.set_mode(own_server, "DUMMY1", own_server.heads[1].mode)
    wait_until(lambda: not shown.problem(), what="all is well")
    wait_until(lambda: np.array_equal(x.grab(own_server, 1), image), what="the image is back")


def test_a_window_that_is_moved_or_covered_comes_back(own_server: XServer, projector: Make) -> None:
    shown, image = projector(own_server), x.noise(own_server, 1)
    shown.open()
    shown.show(image)
    with x.client(own_server) as display:
        x.top_window(display).configure(x=11, y=7)
        display.sync()
        wait_until(lambda: np.array_equal(x.grab(own_server, 1), image), what="the window is back in its place")
        screen = display.screen()
        other = screen.root.create_window(
            700, 10, 100, 100, 0, screen.root_depth, background_pixel=0xFFFFFF, override_redirect=True
        )
        other.map()
        other.configure(stack_mode=X.Above)
        display.sync()
        wait_until(lambda: np.array_equal(x.grab(own_server, 1), image), what="the window is on top again")
    wait_until(lambda: not shown.problem(), what="all is well")


def test_a_compositor_is_reported(own_server: XServer, projector: Make) -> None:
    with x.client(own_server) as display:
        window = display.screen().root.create_window(0, 0, 8, 8, 0, display.screen().root_depth)
        window.set_selection_owner(display.intern_atom("_NET_WM_CM_S0"), X.CurrentTime)
        display.sync()
        shown = projector(own_server)
        shown.open()
        assert any("compositor" in note for note in shown.notes)


def test_the_screen_saver_waits_until_close(own_server: XServer, projector: Make) -> None:
    def timeout_s() -> int:
        with x.client(own_server) as display:
            return int(display.get_screen_saver().timeout)

    with x.client(own_server) as display:
        display.set_screen_saver(600, 60, X.DefaultBlanking, X.DefaultExposures)
        display.sync()
    shown = projector(own_server)
    shown.open()
    assert timeout_s() == 0
    shown.close()
    assert timeout_s() == 600


def test_hooks_run_around_the_window(server: XServer, projector: Make, tmp_path: Path) -> None:
    def note(word: str) -> list[str]:
        return [sys.executable, "-c", f"import os; open('log', 'a').write('{word} ' + os.environ['FRINGED_OUTPUT'])"]

    hook = {"open": [note("open")], "show": [note(" show")], "close": [note(" close")], "timeout_s": 30.0}
    shown = projector(server, hook=hook)
    shown.open()
    shown.show(x.noise(server, 1))
    assert shown.problem() == ""
    shown.close()
    assert (tmp_path / "log").read_text() == "open DUMMY1 show DUMMY1 close DUMMY1"
