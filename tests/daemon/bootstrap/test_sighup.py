"""SIGHUP: a request to reload, or the end of a terminal."""

from __future__ import annotations

import logging
import os
import signal
import threading
from pathlib import Path
from types import SimpleNamespace

import pytest

from daemon.bootstrap.run import StopFlag
from daemon.bootstrap.sighup import Reloads, hung_up, terminals
from daemon.control.settings.reload import Reloader
from tests.daemon.bootstrap.systemd.manager import PATIENT
from tools.waiting import wait_until

pytestmark = PATIENT

VALID = "cameras: {driver: sim}\n"


def test_a_request_waits_until_the_daemon_is_ready() -> None:
    done, ready = threading.Event(), [False]
    reloads = Reloads(done.set, ready=lambda: ready[0])
    reloads.request()
    reloads.tick()
    assert not done.is_set()
    ready[0] = True
    reloads.tick()
    assert done.wait(90)


def test_requests_during_a_reload_are_merged_into_one() -> None:
    begun, go_on, count = threading.Semaphore(0), threading.Semaphore(0), [0]

    def reload() -> None:
        count[0] += 1
        begun.release()
        go_on.acquire()

    reloads = Reloads(reload, ready=lambda: True)
    reloads.request()
    reloads.tick()
    assert begun.acquire(timeout=90)
    for _ in range(5):
        reloads.request()
        reloads.tick()
    assert count == [1]
    go_on.release()
    wait_until(lambda: (reloads.tick(), count[0] == 2)[1])
    go_on.release()
    thread = reloads._thread
    assert thread is not None
    thread.join(90)
    reloads.tick()
    assert count == [2]


@pytest.mark.parametrize("content", ["device: {name: rig-x}\n", "device: {nam: rig-x}\n"], ids=["good", "bad"])
def test_one_request_gives_one_line_in_the_log_and_its_failure_ends_nothing(
    content: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "rig.yaml"
    file.write_text(f"{VALID}{content}")
    changer = SimpleNamespace(apply=lambda _: ["device.name"])
    reloader = Reloader(changer, file, lambda: "")  # type: ignore[arg-type]
    with caplog.at_level(logging.INFO, "fringed"):
        reloads = Reloads(reloader.reload, ready=lambda: True)
        reloads.request()
        reloads.tick()
        thread = reloads._thread
        assert thread is not None
        thread.join(90)
    (line,) = caplog.messages
    if "nam:" in content:
        assert line.startswith("not reloaded, nothing was changed") and "rig.yaml" in line
    else:
        assert line == "reloaded: device.name"


def test_the_signal_requests_a_reload_and_does_not_stop() -> None:
    asked: list[str] = []
    with StopFlag().on_signals() as flag:
        flag.stop = lambda: asked.append("stop")
        os.kill(os.getpid(), signal.SIGHUP)  # no reload is registered yet: nothing happens
        flag.reload = lambda: asked.append("reload")
        os.kill(os.getpid(), signal.SIGHUP)
        os.kill(os.getpid(), signal.SIGTERM)
    assert asked == ["reload", "stop"]


def test_a_closed_terminal_differs_from_an_open_one() -> None:
    master, slave = os.openpty()
    reader, writer = os.pipe()
    ours = terminals((slave, reader))
    assert ours == (slave,) and not hung_up(ours)
    os.close(master)
    assert hung_up(ours)
    os.close(writer)
    assert not hung_up(terminals((reader,)))  # a pipe without a writer is no terminal
    os.close(slave)
    os.close(reader)
