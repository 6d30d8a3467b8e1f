"""The X server without hardware: requested sizes, nothing left behind, and a message when it does not start."""

from __future__ import annotations

import tempfile
from pathlib import Path

import pytest

from drivers.errors import DriverError
from drivers.projector import outputs
from sim.box.xserver import Head, XServer, XServerError
from tests.drivers.projector import x
from tests.open_files import open_files


def test_outputs_have_the_sizes_and_rates_asked_for_side_by_side() -> None:
    heads = Head(640, 480), Head(912, 1140), Head(320, 256, 59.94)
    server = x.start(XServer(heads))
    try:
        found = [output for output in outputs(server.display) if output.connected]
    finally:
        server.stop()
    assert [(o.name, o.size, o.preferred_size) for o in found] == [
        (f"DUMMY{n}", (h.width, h.height), (h.width, h.height)) for n, h in enumerate(heads)
    ]
    assert [o.position for o in found] == [(0, 0), (640, 0), (1552, 0)]
    assert [o.refresh_hz for o in found] == pytest.approx([60, 60, 59.94], abs=0.01)
    assert all(o.is_on and o.gamma_identity and o.rotation == "normal" and not o.scaled for o in found)


def test_xvfb_has_one_output() -> None:
    server = x.start(XServer([Head(640, 480)], kind="xvfb"))
    try:
        assert [(o.name, o.size) for o in outputs(server.display) if o.is_on] == [("screen", (640, 480))]
    finally:
        server.stop()


def test_servers_run_side_by_side_restart_in_place_and_leave_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))  # other tests start servers at the same time
    before = open_files()
    one, two = x.start(XServer()), x.start(XServer())
    try:
        assert one.display != two.display
        display, pid = one.display, one.pid
        one.kill()
        assert not one.alive and two.alive
        one.restart()
        assert one.display == display and one.pid != pid and one.alive
        assert one.environment()["DISPLAY"] == display
        assert len(list(tmp_path.glob("fringed-x-*"))) == 2
    finally:
        one.stop()
        two.stop()
    assert not one.alive
    assert open_files() <= before
    assert not list(tmp_path.iterdir())
    with pytest.raises(XServerError, match="not running"):
        _ = one.pid


def test_a_server_that_does_not_start_gives_the_reason() -> None:
    running = x.start(XServer())
    try:
        second = XServer()
        second.display = running.display
        with pytest.raises(XServerError, match=r"(?s)ended with 1 while starting.*already running"):
            second.start()
    finally:
        running.stop()


def test_without_the_program_the_packages_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(XServerError, match="xserver-xorg-video-dummy"):
        XServer().start()


@pytest.mark.parametrize("size", [(63, 480), (640, 5000), (321, 256)])
def test_sizes_that_x_cannot_have_are_refused(size: tuple[int, int]) -> None:
    with pytest.raises(ValueError, match=f"{size[0]}x{size[1]}"):
        Head(*size)


def test_a_display_that_is_not_there_is_named() -> None:
    with pytest.raises(DriverError, match=":4711: no connection; is the X server running"):
        outputs(":4711")
