"""A daemon over images of nothing, with files that can be changed and reloaded."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from daemon.common.errors import DaemonError
from daemon.config import load_rig
from daemon.config.rig_config import RigConfig
from daemon.control.methods import Methods
from daemon.control.settings.changed_files import read_again
from daemon.live.service import Service
from daemon.live.status import State
from daemon.recording.recorder import Recorder
from daemon.rig.open_rig import Rig
from tests.daemon.rigs import Collector, devices, rig_of, step
from tools.waiting import wait_until

RIG = """cameras: {{driver: sim}}
calibration: calibration.yaml
volume: {{near_mm: {near}, far_mm: {far}}}
stream: {{endpoints: ['ipc://{tmp}/s']}}
control: {{endpoint: 'ipc://{tmp}/c'}}
"""


class Listening(Collector):
    """A sink that takes changes over and keeps its state at each cloud."""

    def __init__(self) -> None:
        super().__init__()
        self.refusal = ""
        self.committed: list[tuple[RigConfig, Rig]] = []

    def change(self, config: RigConfig, rig: Rig) -> Callable[[], None]:
        if self.refusal:
            raise DaemonError(self.refusal)
        return lambda: self.committed.append((config, rig))


class Running:
    """A daemon over images of nothing, with its files."""

    def __init__(self, path: Path) -> None:
        self.path, self.devices = path, devices()
        self.write_calibration(self.devices.calibration)
        self.rig_file = path / "rig.yaml"
        self.write()
        config = load_rig(self.rig_file)
        self.sink = Listening()
        rig = read_again(rig_of(self.devices), config, path)
        self.service = Service(config, rig, {"stream": self.sink})
        self.recorder = Recorder(
            self.service.router, self.service.config, path / "takes", lambda _: Collector(), clock=self.service.clock
        )
        self.methods = Methods(self.service, self.recorder, path=self.rig_file, base_dir=path).table()
        self.thread = threading.Thread(target=self.service.run)
        self.thread.start()
        wait_until(lambda: self.service.state()[0] is State.RUNNING, 90)
        wait_until(lambda: all(camera.status.state == "acquiring" for camera in self.service.cameras.values()))

    def write_calibration(self, data: Any) -> None:
        (self.path / "calibration.yaml").write_text(yaml.safe_dump(dict(data), sort_keys=False))

    def write(self, more: str = "", near: float = 1200.0, far: float = 1500.0) -> None:
        self.rig_file.write_text(RIG.format(tmp=self.path, near=near, far=far) + more)

    def call(self, method: str, /, **params: object) -> Any:
        return self.methods[method](params)

    def clouds(self, count: int) -> None:
        """At least so many clouds more; on a busy machine a frame may miss its partner, so triggers go on."""
        wanted, end = self.service.worker.clouds + count, time.monotonic() + 90
        while self.service.worker.clouds < wanted:
            assert time.monotonic() < end, "no clouds come"
            before = self.service.worker.clouds
            step(self.devices)
            with suppress(TimeoutError):
                wait_until(lambda before=before: self.service.worker.clouds > before, 2)  # type: ignore[misc]

    def as_it_is(self) -> tuple[object, ...]:
        service = self.service
        used = service.worker._config, service.worker._reconstructor, service.pairer._pairer.settings
        return service.config, service.settings, service.rig, *used, len(self.sink.committed)

    def stop(self) -> None:
        self.service.request_stop()
        self.thread.join(60)
        assert not self.thread.is_alive()


def warmed(path: Path) -> Running:
    """One that has measured some pairs."""
    made = Running(path)
    for _ in range(4):  # the first ones wait until the cameras' counts are believed
        step(made.devices)
    made.clouds(1)
    wait_until(lambda: not made.service.worker._queue)
    return made
