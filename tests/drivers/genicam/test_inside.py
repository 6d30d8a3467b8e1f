"""The driver in one process, without the wall between: what harvesters does to a process that does not defend itself.

Each test is a program of its own, as vendors' libraries cannot be unloaded.
"""

from __future__ import annotations

import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path

import pytest

Program = Callable[[str], str]

PROLOGUE = """
import gc, os, signal, sys, tempfile, threading, time
from pathlib import Path
from drivers.errors import DeviceLost
from drivers.genicam.camera import GenicamCamera
from drivers.genicam.options import parse
from sim.gentl.cable import Cable

cti = Path(sys.argv[1])
world = Path(os.environ["FRINGED_GENTL_DIR"])
cables = {name: Cable(world, k, serial=name, size=(64, 48)) for k, name in enumerate(("A1", "A2"))}

def make(serial="A1", **options):
    options = {"producer": str(cti), "serial": serial, "exposure_us": 500.0, **options}
    return GenicamCamera("left", parse("left", options), [cti])

def expose(camera, serial="A1"):
    assert cables[serial].wait_armed(5)
    cables[serial].pulse()
    frame = camera.read(5.0)
    assert frame is not None
    return frame

def lose(camera):
    try:
        for _ in range(50):
            camera.read(0.1)
    except DeviceLost:
        return
    raise AssertionError("the loss was not seen")
"""


@pytest.fixture
def program(world: Path, ours: Path) -> Program:  # noqa: ARG001 - the directory is in the environment
    """Runs a program with two cameras; its output."""

    def run(text: str) -> str:
        result = subprocess.run(
            [sys.executable, "-c", PROLOGUE + textwrap.dedent(text), str(ours)],
            capture_output=True,
            text=True,
            timeout=100,
            check=False,
        )
        assert result.returncode == 0, result.stdout + result.stderr
        return result.stdout

    return run


def test_the_interrupt_handler_stays_as_it_was(program: Program) -> None:
    program("""
        before = signal.getsignal(signal.SIGINT)
        camera = make()
        camera.open()
        assert signal.getsignal(signal.SIGINT) is before
        camera.close()
    """)


def test_a_camera_that_vanished_can_be_opened_again_in_the_same_process(program: Program) -> None:
    program("""
        camera = make()
        for _ in range(3):
            camera.open()
            camera.start()
            assert expose(camera).trigger == 0
            cables["A1"].unplug()
            lose(camera)
            camera.close()
            cables["A1"].plug()
    """)


def test_images_are_copies(program: Program) -> None:
    program("""
        import numpy as np
        camera = make(buffers=3)
        camera.open()
        camera.start()
        kept = []
        for k in range(12):
            cables["A1"].show(np.full((48, 64), 20 * k + 5, np.uint8))
            kept.append(expose(camera))
        assert [int(frame.image[7, 9]) for frame in kept] == [20 * k + 5 for k in range(12)]
        assert all((frame.image == frame.image[0, 0]).all() for frame in kept)
    """)


def test_other_threads_run_while_the_camera_waits(program: Program) -> None:
    program("""
        camera = make()
        camera.open()
        camera.start()
        turns = 0
        done = threading.Event()
        def work():
            global turns
            while not done.is_set():
                time.sleep(0)
                turns += 1
        thread = threading.Thread(target=work)
        thread.start()
        assert camera.read(0.5) is None
        held = turns
        done.set()
        thread.join()
        assert held > 200, held  # a wait in the producer holds Python's lock throughout
        camera.close()
    """)


def test_the_number_of_buffers_is_what_was_asked_for(program: Program) -> None:
    program("""
        camera = make(buffers=7)
        camera.open()
        camera.start()
        for k in range(10):
            assert cables["A1"].pulse()
            assert cables["A1"].wait_idle(5)
        state = cables["A1"].state()
        assert (state.delivered, state.no_buffer) == (7, 3), state
        numbers = []
        while (frame := camera.read(0.2)) is not None:
            numbers.append(frame.trigger)
        assert numbers == list(range(7)), numbers
        assert expose(camera).trigger == 10
        counters = camera.health().counters
        assert (counters["no_buffer"], counters["lost"]) == (3, 0), counters
    """)


def test_nothing_is_left_in_the_temporary_directory(
    program: Program, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    program("""
        camera = make()
        for _ in range(3):
            camera.open()
            camera.start()
            expose(camera)
            camera.close()
        assert os.listdir(os.environ["TMPDIR"]) == []
    """)


def test_opening_and_closing_does_not_grow(program: Program) -> None:
    program("""
        def resident_kb():
            gc.collect()
            return int(Path("/proc/self/statm").read_text().split()[1]) * 4
        camera = make()
        sizes = []
        for k in range(30):
            camera.open()
            camera.start()
            expose(camera)
            camera.stop()
            camera.close()
            sizes.append(resident_kb())
        print("kB a cycle:", (sizes[-1] - sizes[9]) / 20)
        assert sizes[-1] - sizes[9] < 20 * 100, sizes
    """)
