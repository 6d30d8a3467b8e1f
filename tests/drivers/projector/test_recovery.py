"""Recovery: the driver reports a process that died, restarts it, shows the last image, leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from drivers.projector import OutputProjector
from drivers.projector.options import ProjectorOptions, read
from sim.box.xserver import XServer
from tests.drivers.projector import x
from tests.open_files import open_files
from tools.waiting import wait_until

Make = Callable[..., OutputProjector]
Showing = tuple[OutputProjector, np.ndarray]


def opened(server: XServer, shown: OutputProjector) -> np.ndarray:
    image = x.noise(server, 1)
    shown.open()
    shown.show(image)
    assert shown.problem() == "" and np.array_equal(x.grab(server, 1), image)
    return image


def watch(shown: OutputProjector) -> tuple[list[str], Callable[[], None]]:
    """Collect every reported problem; return the list and a function that ends it."""
    problems: list[str] = []
    over = threading.Event()

    def poll() -> None:
        while not over.wait(0.005):
            if (problem := shown.problem()) and problem not in problems:
                problems.append(problem)

    thread = threading.Thread(target=poll)
    thread.start()

    def end() -> None:
        over.set()
        thread.join()

    return problems, end


def recovers(server: XServer, shown: OutputProjector, image: np.ndarray, harm: Callable[[], None], word: str) -> None:
    """After a fault the problem is reported with that word, then another window shows the image again."""
    first, restarts, (problems, end) = shown.window_pid, shown.counted["restarts"], watch(shown)
    try:
        harm()
        wait_until(lambda: any(word in problem for problem in problems), what=f"'{word}' is reported, only: {problems}")
        wait_until(lambda: not shown.problem(), what="all is well again")
    finally:
        end()
    assert np.array_equal(x.grab(server, 1), image)
    assert shown.window_pid != first and not Path(f"/proc/{first}").exists()
    assert shown.counted["restarts"] > restarts


@pytest.fixture(scope="module")
def showing(server: XServer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Showing]:
    """A projector that shows an image, and the image; every test leaves them so."""
    values = {"output": "DUMMY1", "display": server.display, "show_timeout_s": 20.0}
    shown = OutputProjector(read(ProjectorOptions, values), tmp_path_factory.mktemp("showing"), hung_s=20.0)
    try:
        yield shown, opened(server, shown)
    finally:
        shown.close()


def test_a_killed_window_comes_back_with_its_image(server: XServer, showing: Showing) -> None:
    shown, image = showing
    recovers(server, shown, image, lambda: os.kill(shown.window_pid, signal.SIGKILL), "signal 9")


def test_a_hung_window_is_replaced(own_server: XServer, projector: Make) -> None:
    shown = projector(own_server, hung_s=4.0)
    image = opened(own_server, shown)
    recovers(own_server, shown, image, lambda: os.kill(shown.window_pid, signal.SIGSTOP), "does not answer")


def test_a_defect_of_ours_costs_one_window_and_not_the_light(server: XServer, showing: Showing) -> None:
    shown, image = showing
    supervisor = shown._supervisor
    assert supervisor is not None
    usual, defects = supervisor._after_show, iter([ZeroDivisionError("a defect")])

    def fails_once() -> None:
        usual()
        for error in defects:
            raise error

    supervisor._after_show = fails_once
    recovers(server, shown, image, lambda: shown.show(image), "ZeroDivisionError")


def test_a_destroyed_window_comes_back(server: XServer, showing: Showing) -> None:
    shown, image = showing

    def destroy() -> None:
        with x.client(server) as display:
            x.top_window(display).destroy()
            display.sync()

    recovers(server, shown, image, destroy, "destroyed by another program")


def test_a_window_taken_off_the_screen_comes_back(server: XServer, showing: Showing) -> None:
    shown, image = showing

    def unmap() -> None:
        with x.client(server) as display:
            x.top_window(display).unmap()
            display.sync()

    recovers(server, shown, image, unmap, "taken off the screen")


def test_an_x_server_that_dies_is_reported_and_used_again(own_server: XServer, projector: Make) -> None:
    shown = projector(own_server)
    image = opened(own_server, shown)
    own_server.kill()
    wait_until(lambda: "X server" in shown.problem(), what="the server's end is reported")
    wait_until(lambda: "no connection" in shown.problem(), what="it is tried again")
    own_server.restart()
    wait_until(lambda: not shown.problem(), what="all is well again")
    assert np.array_equal(x.grab(own_server, 1), image)


def test_an_image_wanted_while_the_server_is_gone_is_shown_later(own_server: XServer, projector: Make) -> None:
    shown = projector(own_server, show_timeout_s=2.0)
    opened(own_server, shown)
    own_server.kill()
    wanted = x.noise(own_server, 1, seed=5)
    assert shown.show(wanted) is None and "no image" in shown.problem()
    own_server.restart()
    wait_until(lambda: not shown.problem(), what="all is well again")
    assert np.array_equal(x.grab(own_server, 1), wanted)


def test_it_closes_at_once_while_the_server_is_gone(own_server: XServer, projector: Make) -> None:
    shown = projector(own_server)
    opened(own_server, shown)
    own_server.kill()
    wait_until(lambda: "X server" in shown.problem(), what="the server's end is reported")
    shown.close()
    assert "closed" in shown.problem()


def test_the_window_ends_with_its_parent_and_puts_the_gamma_table_back(own_server: XServer) -> None:
    server, bent = own_server, x.bend_gamma(own_server, "DUMMY1")
    code = (
        "import sys, time; from pathlib import Path; from drivers.projector import open_projector\n"
        f"p = open_projector({{'output': 'DUMMY1', 'gamma': 'reset', 'display': '{server.display}'}}, Path())\n"
        "p.open(); print(p.window_pid, flush=True); time.sleep(600)"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    assert parent.stdout is not None
    with parent.stdout:
        window = int(parent.stdout.readline())
        assert Path(f"/proc/{window}").exists()
        parent.kill()
        parent.wait()

    def gone() -> bool:
        try:
            return Path(f"/proc/{window}/stat").read_text().rpartition(")")[2].split()[0] == "Z"
        except (FileNotFoundError, ProcessLookupError):
            return True

    wait_until(gone, what="the window's process is gone")
    with x.client(server) as display:
        wait_until(lambda: x.top_window(display) is None, what="the window is gone")
    assert np.array_equal(x.gamma(server, "DUMMY1"), bent)


@pytest.mark.parametrize("cycles", [2, pytest.param(20, marks=pytest.mark.long)])
def test_nothing_is_left_behind_by_many_lives(own_server: XServer, projector: Make, cycles: int) -> None:
    def left() -> tuple[int, int, int]:
        children = Path(f"/proc/self/task/{threading.get_native_id()}/children").read_text().split()
        return open_files(), len(children), threading.active_count()

    image, before = x.noise(own_server, 1), None
    for cycle in range(cycles):
        shown = projector(own_server)
        shown.open()
        shown.show(image)
        if cycle % 4 == 1:
            os.kill(shown.window_pid, signal.SIGKILL)
            wait_until(lambda shown=shown: not shown.problem(), what="all is well again")
        shown.close()
        before = before or left()
    assert left() == before
