"""The rig of a campaign: a rig in a box, a daemon under a guard, a disk, a clock, and a watching subscriber."""

from __future__ import annotations

import os
import threading
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml

from benchmarks.campaign.disk import Disk
from benchmarks.campaign.shifted_clock import ShiftedClock
from benchmarks.campaign.tampered_cable import TamperedCable
from benchmarks.common.daemon_process import DaemonProcess
from drivers.protocols import SIDES
from fringed import wire
from fringed.errors import ControlError
from fringed.stream.receiver import Receiver
from sim.box.box import GENTL_DIR, Box
from sim.box.exposure_ledger import Ledger
from sim.box.options import from_mapping

RECOVERY_S = 90.0
_REMEMBERED = 200_000


class Watcher:
    """A subscriber that counts clouds and notes the time of the last one."""

    def __init__(self, endpoint: str) -> None:
        self.clouds, self.last_s = 0, 0.0
        self._receiver = Receiver(endpoint, ["cloud/depth"], queue=8)
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watcher", daemon=True)
        self._thread.start()

    def after(self, moment_s: float, timeout_s: float) -> float | None:
        """Seconds from a moment (monotonic) to the second cloud after it: the first may have been on its way."""
        end, first = time.monotonic() + timeout_s, None
        while time.monotonic() < end:
            clouds, last_s = self.clouds, self.last_s
            if last_s > moment_s:
                first = clouds if first is None else first
                if clouds > first:
                    return last_s - moment_s
            time.sleep(0.01)
        return None

    def close(self) -> None:
        """Disconnect."""
        self._over.set()
        self._thread.join()
        self._receiver.close()

    def _run(self) -> None:
        while not self._over.is_set():
            if not self._receiver.poll(0.1):
                continue
            while (frames := self._receiver.take()) is not None:
                wire.decode_header(frames)
                self.clouds, self.last_s = self.clouds + 1, time.monotonic()


class CampaignRig:
    """Box, daemon, disk, clock and subscriber; for ``with``.

    Args:
        directory: an empty one; scale: of the images, 1 = 1024 x 820; rate_hz: of the triggers.
    """

    def __init__(self, directory: Path, *, scale: float, rate_hz: float, disk_mb: int = 400) -> None:
        self.directory, self._scale, self._rate_hz, self._disk_mb = directory, scale, rate_hz, disk_mb
        self._stack = ExitStack()
        self.dark = threading.Event()

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            self.clock = ShiftedClock(self.directory)
            self.disk = Disk(self.directory / "disk", self._disk_mb)
            stack.callback(self.disk.close)
            folder = self.directory / "box"
            folder.mkdir()
            options = from_mapping(
                {
                    "tcp": 0,
                    "exposure_us": 1000,
                    "readout_us": 1000,
                    "folder": str(folder),
                    "simulation": {"scene": "plane", "frames": 1, "layout": {"scale": self._scale}},
                }
            )
            self.box = stack.enter_context(Box(options, ledger=Ledger(keep=_REMEMBERED)))
            self.cables = {side: TamperedCable(self.box.cables[side]) for side in SIDES}
            self.box.world._cables = dict(self.cables)
            self.config = self._write_rig()
            environment = {GENTL_DIR: str(self.box.gentl_dir), **self.clock.environment}
            self.daemon = stack.enter_context(
                DaemonProcess(
                    self.box.rig_file,
                    self.config["control"]["endpoint"],
                    self.directory / "daemon.log",
                    environment=environment,
                    restart=True,
                )
            )
            over = threading.Event()
            world = threading.Thread(target=self._give, args=(over,), name="world")
            world.start()
            stack.callback(world.join)
            stack.callback(over.set)
            self.watcher = Watcher(self.config["stream"]["endpoints"][0])
            stack.callback(self.watcher.close)
            if self.watcher.after(time.monotonic(), 300.0) is None:
                raise SystemExit(f"no cloud at all:\n{self.daemon.log.read_text()[-4000:]}")
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    @property
    def triggers(self) -> int:
        """Edges given so far."""
        return self.box.world.triggers

    def ensure_recording(self) -> str:
        """Begin a take if none is being written; the error, or an empty text."""
        try:
            if not self.daemon.ask("status")["recorder"].get("recording"):
                self.daemon.ask("record.start", name="campaign", timeout_s=20.0)
        except ControlError as error:
            return str(error)
        return ""

    def write_rig(self, **changes: Any) -> None:
        """The rig file with some sections changed."""
        self.box.rig_file.write_text(yaml.safe_dump(self.config | changes))

    def _write_rig(self) -> dict[str, Any]:
        rig: dict[str, Any] = yaml.safe_load(self.box.rig_file.read_text())
        rig["recording"] = {"dir": str(self.disk.takes), "max_part_mb": 16, "min_free_mb": 8}
        rig["pipeline"] = {"temporal_prior": False}
        self.config = rig
        self.write_rig()
        return rig

    def _give(self, over: threading.Event) -> None:
        """Give triggers at a steady rate, none while it is dark."""
        due = time.monotonic()
        while not over.wait(max(0.0, due - time.monotonic())):
            if not self.dark.is_set():
                self.box.world.step(settle=False)
            due = max(due + 1 / self._rate_hz, time.monotonic())


def pause(seconds: float) -> None:
    """Let the fault last."""
    time.sleep(seconds)


def alive(pid: int) -> bool:
    """Whether there is such a process."""
    try:
        os.kill(pid, 0)
    except OSError:
        return False
    return True
