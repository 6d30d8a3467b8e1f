"""Each camera belongs to one process at a time, whatever becomes of that process."""

from __future__ import annotations

import contextlib
import json
import os
import queue
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest

from sim.gentl.cable import Cable
from tests.sim.gentl.conftest import HEIGHT, WIDTH
from tests.sim.gentl.host import WAIT_S, ResourceInUseException, opened

Cables = Callable[..., Cable]
REPOSITORY = Path(__file__).parents[3]


class Holder:
    """A process that has a camera open and reports its frames."""

    def __init__(self, producer: Path, serial: str) -> None:
        command = [sys.executable, "-m", "tests.sim.gentl.holder", str(producer), serial]
        self.process = subprocess.Popen(
            command, cwd=REPOSITORY, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=dict(os.environ)
        )
        self._lines: queue.Queue[str] = queue.Queue()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()
        assert self._lines.get(timeout=60) == "armed\n"

    def frame(self) -> dict[str, int]:
        """The next frame that it reports."""
        return dict(json.loads(self._lines.get(timeout=WAIT_S)))

    def end(self, *, kill: bool = False) -> None:
        """Let it end, or kill it as nothing can be caught."""
        if kill:
            self.process.kill()
        assert self.process.stdin is not None
        self.process.stdin.close()
        assert self.process.wait(60) == (-9 if kill else 0)
        self._reader.join(10)
        assert self.process.stdout is not None
        self.process.stdout.close()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self._lines.put(line)


@pytest.fixture
def holder(producer: Path) -> Iterator[Callable[[str], Holder]]:
    """``holder("CAM0")`` is a process with that camera open."""
    holders: list[Holder] = []

    def start(serial: str) -> Holder:
        holders.append(Holder(producer, serial))
        return holders[-1]

    yield start
    for one in holders:
        if one.process.poll() is None:
            with contextlib.suppress(BrokenPipeError):
                one.end()


def test_two_processes_with_a_camera_each_see_the_same_pulses(cable: Cables, holder: Callable[[str], Holder]) -> None:
    cameras = [cable(), cable(number=1)]
    cameras[1].set_clock(offset_ns=77 * 10**12, drift_ppm=30.0)
    holders = [holder("CAM0"), holder("CAM1")]
    for k in range(20):
        t_ns = time.monotonic_ns()
        for camera in cameras:
            camera.show(np.full((HEIGHT, WIDTH), 10 + k, np.uint8))
            assert camera.pulse(t_ns + k * 10_000_000)
        for camera, one in zip(cameras, holders, strict=True):
            expected = {"frame_id": k, "timestamp": camera.device_ns(t_ns + k * 10_000_000), "first": 10 + k}
            assert one.frame() == expected
    assert [camera.state().open_by for camera in cameras] == [one.process.pid for one in holders]
    for one in holders:
        one.end()
    assert [camera.state().open_by for camera in cameras] == [0, 0]


def test_a_camera_that_is_open_is_refused_to_others_until_it_is_free(
    producer: Path, cable: Cables, holder: Callable[[str], Holder]
) -> None:
    camera = cable()
    cable(number=1)
    one = holder("CAM0")
    with opened(producer, "CAM1"):
        pass
    with pytest.raises(ResourceInUseException), opened(producer, "CAM0"):
        pass
    assert camera.pulse()
    assert one.frame()["frame_id"] == 0
    one.end()
    with opened(producer, "CAM0"):
        assert camera.state().open_by == os.getpid()


def test_a_killed_process_leaves_the_camera_free_and_at_rest(
    producer: Path, cable: Cables, holder: Callable[[str], Holder]
) -> None:
    camera = cable(real_time=True)
    one = holder("CAM0")
    assert camera.state().armed
    assert camera.pulse(time.monotonic_ns() + 3600 * 10**9)  # never answered
    one.end(kill=True)
    assert camera.state().open_by == 0
    assert not camera.pulse()
    assert camera.wait_idle(0)
    with opened(producer, "CAM0") as (host,):
        assert not camera.state().armed
        assert host.get("TLParamsLocked") == 0
        host.start()
        assert camera.state().armed, "its settings are still there"
        assert camera.pulse()
        assert host.captures(1)[0].frame_id == 0


def test_a_plug_pulled_while_another_process_holds_the_camera_frees_it(
    producer: Path, cable: Cables, holder: Callable[[str], Holder]
) -> None:
    camera = cable()
    one = holder("CAM0")
    camera.unplug()
    deadline = time.monotonic() + WAIT_S
    while camera.state().open_by and time.monotonic() < deadline:
        time.sleep(0.001)
    assert (camera.state().open_by, camera.state().armed, camera.pulse()) == (0, False, False)
    camera.plug()
    with opened(producer, "CAM0") as (host,):
        assert host.get("TriggerMode") == "Off"
        host.trigger_on()
        host.start()
        one.end()  # of the connection that is long dead
        assert camera.state().open_by == os.getpid()
        assert camera.pulse()
        assert host.captures(1)[0].frame_id == 0
