"""A camera in a process of its own: what is delivered, what is counted, and what happens when the process does not."""

from __future__ import annotations

import gc
import logging
import os
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.errors import DeviceLost, DriverError, SettingRefused
from drivers.protocols import Camera, Frame
from drivers.remote import RemoteCamera
from drivers.remote.camera import Limits
from tests.open_files import open_files
from tools.waiting import wait_until

TARGET = "tests.drivers.remote.fake:open_camera"
QUICK = Limits(slots=8, silence_s=0.5, open_s=20.0, command_s=5.0, close_s=2.0)


@pytest.fixture
def camera() -> Iterator[Callable[..., RemoteCamera]]:
    made: list[RemoteCamera] = []

    def make(limits: Limits = QUICK, **options: Any) -> RemoteCamera:
        made.append(RemoteCamera("left", TARGET, options, Path("/"), limits=limits))
        return made[-1]

    yield make
    for one in made:
        one.close()


def frames(camera: RemoteCamera, count: int, within_s: float = 10.0) -> list[Frame]:
    end = time.monotonic() + within_s
    found: list[Frame] = []
    while len(found) < count and time.monotonic() < end:
        frame = camera.read(0.2)
        found += [] if frame is None else [frame]
    assert len(found) == count
    return found


def gone(pid: int, within_s: float = 10.0) -> bool:
    try:
        watched = os.pidfd_open(pid)
    except ProcessLookupError:
        return True
    try:
        return bool(select.select([watched], [], [], within_s)[0])
    finally:
        os.close(watched)


@pytest.mark.parametrize(
    ("encoding", "own_memory"),
    [
        ("mono16", True),
        ("rgb8", False),
        *(
            pytest.param(*each, marks=pytest.mark.long)
            for each in (("mono8", False), ("mono8", True), ("mono16", False), ("rgb8", True))
        ),
    ],
)
def test_frames_arrive_whole_in_order_and_read_only(camera: Any, encoding: str, own_memory: bool) -> None:
    remote = camera(frames=40, encoding=encoding, own_memory=own_memory)
    assert isinstance(remote, Camera)
    info = remote.open()
    assert (info.model, info.serial, info.size, info.encoding, info.notes) == (
        "Fake",
        "F1",
        (48, 32),
        encoding,
        ("a note",),
    )
    remote.start()
    last = -1
    while last < 39:
        (frame,) = frames(remote, 1)
        assert frame.trigger > last
        last = frame.trigger
        assert (frame.side, frame.encoding, frame.t_exposure_ns) == ("left", encoding, frame.trigger * 1000)
        assert (frame.exposure_us, frame.t_device_ns, frame.frame_id) == (100.0, 5, 7)
        assert not frame.image.flags.writeable
        assert frame.image.dtype == (np.uint16 if encoding == "mono16" else np.uint8)
        assert (frame.image == frame.trigger % 251).all()
        with pytest.raises(ValueError, match="read-only"):
            frame.image[0] = 1


def test_kept_images_are_never_overwritten_and_slots_come_back(camera: Any) -> None:
    remote = camera(frames=600, pause_s=0.001)
    remote.open()
    remote.start()
    kept: list[tuple[int, Any]] = []
    last = -1
    while last < 599:
        frame = remote.read(1.0)
        assert frame is not None
        assert frame.trigger > last
        last = frame.trigger
        if last % 7 == 0:
            kept.append((last, frame.image[3:5]))  # a view keeps the whole slot
            kept = kept[-2:] if last < 300 else kept[-30:]
        for number, image in kept:
            assert (image == number % 251).all()
    counters = remote.health().counters
    assert counters["shared"] > 3 * QUICK.slots, "slots do not come back"
    assert counters["copied"] > 0, "more images were kept than there are slots"
    remote.close()
    gc.collect()
    for number, image in kept:
        assert (image == number % 251).all(), "the memory went with the process"


def test_images_given_back_are_never_copied(camera: Any) -> None:
    remote = camera(frames=300)
    remote.open()
    remote.start()
    last = -1
    while last < 299:
        frame = remote.read(1.0)
        assert frame is not None
        last = frame.trigger
        del frame
    assert remote.health().counters["copied"] == 0


def test_images_may_die_in_any_thread(camera: Any) -> None:
    remote = camera(frames=2000)
    remote.open()
    remote.start()
    held: list[Frame] = []
    done = threading.Event()

    def drop() -> None:
        while not done.is_set():
            if held:
                held.pop()
            gc.collect(0)

    thread = threading.Thread(target=drop)
    thread.start()
    try:
        last = -1
        while last < 1999:
            frame = remote.read(2.0)
            assert frame is not None
            assert (frame.image == frame.trigger % 251).all()
            last = frame.trigger
            held.append(frame)
            del frame
    finally:
        done.set()
        thread.join()


def test_when_nobody_reads_the_oldest_are_dropped_and_counted(camera: Any) -> None:
    remote = camera(frames=100)
    remote.open()
    remote.start()
    wait_until(lambda: remote.health().counters.get("given", 0) == 100)
    wait_until(lambda: remote.health().counters["ring_full"] > 0)
    found = []
    while (frame := remote.read(0.3)) is not None:
        found.append(frame.trigger)
    assert found == sorted(found)
    assert found[-1] == 99, "the newest must survive"
    assert len(found) + remote.health().counters["ring_full"] == 100
    assert len(found) <= QUICK.slots


def test_stopping_drops_what_was_not_read_and_starting_goes_on(camera: Any) -> None:
    remote = camera(frames=1000000)
    remote.open()
    remote.start()
    before = frames(remote, 5)[-1].trigger
    remote.stop()
    assert remote.read(0.05) is None
    remote.start()
    assert frames(remote, 1)[0].trigger > before


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"at_open": "refused"}, SettingRefused, "exposure_us 1 became 10"),
        ({"at_open": "driver"}, DriverError, "two cameras fit"),
        ({"at_open": "lost"}, DeviceLost, "the plug was pulled"),
        ({"at_open": "bug"}, DriverError, "KeyError"),
        ({"at_open": "exit"}, DeviceLost, "exit status 3.*ends here"),
    ],
)
def test_opening_reports_why_it_failed(
    camera: Any, options: dict[str, Any], error: type[Exception], message: str
) -> None:
    remote = camera(**options)
    with pytest.raises(error, match=message):
        remote.open()
    assert remote.pid is None


@pytest.mark.parametrize(
    "then", ["kill", "hold_lock", *(pytest.param(each, marks=pytest.mark.long) for each in ("lost", "exit", "hang"))]
)
def test_any_end_of_the_process_is_a_lost_device_and_opening_starts_another(camera: Any, then: str) -> None:
    remote = camera(frames=3, then=then)
    remote.open()
    remote.start()
    first = remote.pid
    assert first is not None
    frames(remote, 3)
    with pytest.raises(DeviceLost):
        for _ in range(50):
            remote.read(0.2)
    assert gone(first), "the process must not outlive its camera"
    assert remote.pid is None
    with pytest.raises(DeviceLost):
        remote.read(0.1)
    remote.open()
    remote.start()
    assert [frame.trigger for frame in frames(remote, 3)] == [0, 1, 2]
    assert remote.pid not in (None, first)
    assert remote.health().counters["processes"] == 2


def test_counters_outlive_the_process(camera: Any) -> None:
    remote = camera(frames=4, then="lost")
    for _ in range(2):
        remote.open()
        remote.start()
        frames(remote, 4)
        with pytest.raises(DeviceLost, match="the plug was pulled"):
            remote.read(1.0)
    assert remote.health().counters["shared"] == 8
    assert remote.health().temperature_c is None


def test_opening_that_hangs_is_given_up(camera: Any) -> None:
    remote = camera(Limits(open_s=1.5), at_open="hang")
    with pytest.raises(DeviceLost, match=r"did not open within 1\.5 s"):
        remote.open()


def test_closing_that_hangs_is_given_up(camera: Any) -> None:
    remote = camera(Limits(close_s=0.2), slow_close=True)
    remote.open()
    pid = remote.pid
    remote.close()
    assert pid is not None and gone(pid)


def test_health_comes_while_nobody_reads(camera: Any) -> None:
    remote = camera(frames=2)
    assert remote.health().temperature_c is None
    remote.open()
    wait_until(lambda: remote.health().temperature_c == 21.5)
    remote.start()
    frames(remote, 2)
    wait_until(lambda: remote.health().counters.get("given") == 2)


def test_what_the_process_prints_goes_to_the_log(
    camera: Any, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    with caplog.at_level(logging.DEBUG, "fringed.camera.left"):
        remote = camera()
        remote.open()
        remote.start()
        wait_until(lambda: "started" in caplog.messages)
    assert capfd.readouterr() == ("", "")


def test_signals_for_the_daemon_do_not_end_the_camera(camera: Any) -> None:
    remote = camera(frames=10**9)
    remote.open()
    remote.start()
    assert remote.pid is not None
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(remote.pid, number)
        frames(remote, 20)


PARENT = """
import sys, time
from pathlib import Path
from drivers.remote import RemoteCamera
camera = RemoteCamera("left", "tests.drivers.remote.fake:open_camera", {"frames": 1, "then": sys.argv[1]}, Path("/"))
camera.open()
camera.start()
camera.read(5.0)
print(camera.pid, flush=True)
time.sleep(600)
"""


@pytest.mark.parametrize("then", [pytest.param("nothing", marks=pytest.mark.long), "hold_lock"])
def test_the_process_ends_when_the_daemon_is_killed(then: str) -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT, then], stdout=subprocess.PIPE, text=True) as parent:
        try:
            assert parent.stdout is not None
            pid = int(parent.stdout.readline())
        finally:
            parent.kill()
    assert gone(pid)


def test_a_camera_outlives_the_thread_that_opened_it(camera: Any) -> None:
    remote = camera(frames=10**9)
    thread = threading.Thread(target=remote.open)
    thread.start()
    thread.join()
    remote.start()
    frames(remote, 20)


def test_closing_twice_is_allowed(camera: Any) -> None:
    remote = camera()
    remote.close()
    remote.open()
    remote.close()
    remote.close()


@pytest.mark.parametrize("openings", [4, pytest.param(50, marks=pytest.mark.long)])
def test_nothing_is_left_behind_by_many_openings(camera: Any, openings: int) -> None:
    def held() -> tuple[int, int, int, list[str]]:
        files = open_files()
        maps = Path("/proc/self/maps").read_text()
        # Zombies are among the children; so may be processes of other tests' fixtures.
        children = sorted(
            c for task in Path("/proc/self/task").iterdir() for c in (task / "children").read_text().split()
        )
        return files, maps.count("fringed-frames"), threading.active_count(), children

    remote = camera(frames=6)
    before = None
    for _ in range(openings):
        remote.open()
        remote.start()
        frames(remote, 6)
        remote.close()
        before = before or held()
    assert held() == before
