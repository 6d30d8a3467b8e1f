"""Daemons in multi-frame modes: one on a small rendered rig, one whose cameras see only how bright it is."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from daemon.config import RigConfig, parse_rig
from daemon.live.service import Service
from daemon.live.status import State
from daemon.rig.open_rig import open_rig
from pipeline.reconstruct.cloud import Cloud
from tests.daemon.lit_rig import FlatReconstructor, FreeProjector, devices
from tests.daemon.rigs import Collector, config, rig_of
from tools.waiting import wait_until

RENDERED = """
cameras: {{driver: sim}}
mode: {mode}
sequence: {sequence}
simulation: {{layout: {{scale: 0.125}}, rate_hz: 30.0, cache_dir: cache, {simulation}}}
pairing: {{max_wait_ms: 5000}}
pipeline: {{queue: 16, settings: {{self_calibrate: false}}}}
stream: {{endpoints: ["ipc://{tmp}/s"]}}
control: {{endpoint: "ipc://{tmp}/c"}}
recording: {{min_free_mb: 10}}
"""


@dataclass
class Running:
    """A daemon, and everything that it gave."""

    service: Service
    sink: Collector
    config: RigConfig
    path: Path


@contextmanager
def _run(service: Service, sink: Collector, settings: RigConfig, path: Path) -> Iterator[Running]:
    thread = threading.Thread(target=service.run)
    thread.start()
    try:
        wait_until(lambda: service.state()[0] in (State.RUNNING, State.DEGRADED) or not thread.is_alive(), 110)
        yield Running(service, sink, settings, path)
    finally:
        service.request_stop()
        thread.join(30)
        assert not thread.is_alive()


@contextmanager
def rendered(path: Path, mode: str = "heterodyne", *, sequence: str = "{}", simulation: str) -> Iterator[Running]:
    """A daemon on the small simulated rig, rendered as its projector shows images."""
    text = RENDERED.format(mode=mode, sequence=sequence, simulation=simulation, tmp=path)
    settings, sink = parse_rig(text), Collector()
    with _run(Service(settings, open_rig(settings, path), {"stream": sink}), sink, settings, path) as running:
        yield running


class FlatSets(FlatReconstructor):
    """Gives clouds without any point for sets, and keeps how bright their images are."""

    def __init__(self, mode: str, seen: list[list[int]]) -> None:
        self.mode, self._seen = mode, seen

    def reconstruct(self, lefts: Any, rights: Any, **_: Any) -> Cloud:
        both = [{int(v) for image in pair for v in np.unique(image)} for pair in zip(lefts, rights, strict=True)]
        assert all(len(levels) == 1 for levels in both), "an image of a set shows one light"
        self._seen.append([levels.pop() for levels in both])
        return super().reconstruct(lefts[0], rights[0])


class UnmeasuringService(Service):
    """The daemon without its pipeline, in any mode."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        #: Brightness of the images of every set that was measured.
        self.seen: list[list[int]] = []
        self.path._reconstructor = self._flat  # type: ignore[method-assign]

    def _flat(self, *_: Any) -> Any:
        plan = self.mode_controller.plan
        return FlatReconstructor() if plan is None else FlatSets(plan.mode, self.seen)


@dataclass
class Lit(Running):
    """A daemon whose cameras see how bright the first pixel of the projector is."""

    service: UnmeasuringService
    projector: FreeProjector

    @property
    def levels(self) -> list[int]:
        """Brightness of the mode's images, one after the other."""
        plan = self.service.mode_controller.plan
        assert plan is not None
        return [int(image[0, 0].max()) for image in plan.images]

    def goes_on(self, count: int = 3) -> None:
        """Wait for further clouds."""
        clouds = self.service.worker.clouds
        wait_until(lambda: self.service.worker.clouds >= clouds + count)


@contextmanager
def lit(path: Path, extra: str) -> Iterator[Lit]:
    """A daemon on a rig that is lit, not rendered, 200 triggers a second."""
    made, projector, _ = devices()
    settings, sink = config(path, "recording: {min_free_mb: 10}\n" + extra), Collector()
    service = UnmeasuringService(settings, rig_of(made), {"stream": sink})
    with _run(service, sink, settings, path):
        yield Lit(service, sink, settings, path, projector)
