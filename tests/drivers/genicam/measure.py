"""What a camera costs, in a process of its own and in a thread: ``python -m tests.drivers.genicam.measure``.

For each way of driving one emulated camera at 30 images a second: from the pulse to the frame in the reader's hands
less exposure and readout (which the emulated camera takes in real time), the processor time of the driver's threads
(the emulated camera's own thread is left out), and how much later than asked another thread of the reader's process
wakes from sleeps of 1 ms.
"""

from __future__ import annotations

import os
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers.genicam import open_camera
from drivers.genicam.camera import GenicamCamera
from drivers.genicam.options import parse
from drivers.protocols import Camera
from sim.gentl.build import build
from sim.gentl.cable import Cable

RATE_HZ, COUNT = 30, 240
SIZE = (1024, 820)
EXPOSURE_US, READOUT_US = 5000.0, 2000.0
_TICKS = os.sysconf("SC_CLK_TCK")


def _thread_cpu_s(pid: int, thread: int) -> float:
    fields = Path(f"/proc/{pid}/task/{thread}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / _TICKS


class Sleeper:
    """A thread that sleeps 1 ms again and again and notes how much longer it took."""

    def __init__(self) -> None:
        self.late_ms: list[float] = []
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def stop(self) -> None:
        self._done.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._done.is_set():
            before = time.perf_counter()
            time.sleep(0.001)
            self.late_ms.append((time.perf_counter() - before - 0.001) * 1e3)


def measure(make: Callable[[], Camera] | None, cable: Cable) -> dict[str, float]:
    """One way of driving the camera; None: no camera at all."""
    camera = make() if make is not None else None
    if camera is not None:
        camera.open()
        camera.start()
        assert cable.wait_armed(10)
    sleeper, latency_ms = Sleeper(), []
    pid = getattr(camera, "pid", None)
    cpu_before, child_before = time.thread_time(), _thread_cpu_s(pid, pid) if pid else 0.0
    begin = time.monotonic_ns() + 50_000_000
    for k in range(COUNT):
        at = begin + k * 10**9 // RATE_HZ
        if camera is None:
            time.sleep(max(0.0, (at - time.monotonic_ns()) / 1e9))
            continue
        cable.pulse(at)
        frame = camera.read(2.0)
        assert frame is not None and frame.trigger == k
        latency_ms.append((time.monotonic_ns() - at) / 1e6 - (EXPOSURE_US + READOUT_US) / 1e3)
        del frame
    seconds = COUNT / RATE_HZ
    reader = (time.thread_time() - cpu_before) / seconds * 100
    child = (_thread_cpu_s(pid, pid) - child_before) / seconds * 100 if pid else 0.0
    sleeper.stop()
    if camera is not None:
        camera.close()
    late = np.percentile(sleeper.late_ms, [50, 99])
    taken = np.percentile(latency_ms, [50, 99]) if latency_ms else (0.0, 0.0)
    return {
        "frame P50 ms": taken[0],
        "frame P99 ms": taken[1],
        "reader's thread %": reader,
        "camera's process %": child,
        "other thread late P50 ms": late[0],
        "other thread late P99 ms": late[1],
    }


def main() -> None:
    """Print the table."""
    library = build()
    shown = np.random.default_rng(0).integers(0, 256, (SIZE[1], SIZE[0], 3), dtype=np.uint8)
    with tempfile.TemporaryDirectory(prefix="cams-") as directory:
        os.environ["FRINGED_GENTL_DIR"] = directory
        with Cable(Path(directory), 0, serial="A1", size=SIZE, readout_us=READOUT_US) as cable:
            cable.show(shown)

            def options(pixel_format: str) -> dict[str, Any]:
                named = {"producer": str(library), "serial": "A1", "exposure_us": EXPOSURE_US}
                return {**named, "pixel_format": pixel_format}

            def process(pixel_format: str) -> Camera:
                return open_camera("left", options(pixel_format), Path("/"))

            def thread(wait_ms: int) -> Camera:
                return GenicamCamera("left", parse("left", options("BayerRG8")), [library], wait_ms=wait_ms)

            ways: dict[str, Callable[[], Camera] | None] = {
                "no camera": None,
                "process, BayerRG8": lambda: process("BayerRG8"),
                "process, RGB8": lambda: process("RGB8"),
                "thread, BayerRG8, polling": lambda: thread(0),
                "thread, BayerRG8, waiting 5 ms": lambda: thread(5),
                "thread, BayerRG8, waiting 50 ms": lambda: thread(50),
            }
            for name, make in ways.items():
                row = measure(make, cable)
                print(f"{name:34}", "  ".join(f"{key} {value:6.2f}" for key, value in row.items()), flush=True)  # noqa: T201


if __name__ == "__main__":
    main()
