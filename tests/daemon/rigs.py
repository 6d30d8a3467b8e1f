"""A rig without light for tests of the daemon: the simulated world's triggers over images of nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daemon.common.heartbeat import Heartbeat
from daemon.config import RigConfig, parse_rig
from daemon.live.items import CloudItem, Item, Pair
from daemon.rig.open_rig import Rig
from pipeline.pattern import color_fringe
from pipeline.rig import calibration
from pipeline.rig.volume import Volume
from sim.devices.open_rig import RigDevices, open_rig

SMALL = {"frames": 2, "rate_hz": 0.0, "layout": {"scale": 0.125}}


class Noise:
    """Images of the size that is asked for."""

    def __init__(self, size: tuple[int, int]) -> None:
        rng = np.random.default_rng(3)
        self._images = [rng.integers(40, 200, (*size[::-1], 3), dtype=np.uint8) for _ in range(2)]
        for image in self._images:
            image.setflags(write=False)

    def pair(self, index: int) -> tuple[Any, Any]:  # noqa: ARG002 - the protocol's
        return self._images[0], self._images[1]


def devices(**options: Any) -> RigDevices:
    """A stepped simulated rig that renders nothing."""
    merged = SMALL | options
    size = open_rig_size(merged)
    return open_rig(merged, Path(), images=Noise(size), clock=SteppedClock())


STEPPED_NS = 50_000_000


class SteppedClock:
    """Real time that the test moves on, 50 ms a trigger, from a fixed start."""

    def __init__(self) -> None:
        self.now_ns = 1_700_000_000_000_000_000

    def realtime_ns(self) -> int:
        return self.now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns


def step(made: RigDevices) -> None:
    """One trigger, 50 ms after the one before."""
    made.trigger._clock.now_ns += STEPPED_NS  # type: ignore[attr-defined]
    made.trigger.step()


def open_rig_size(options: dict[str, Any]) -> tuple[int, int]:
    from sim.devices.options import from_mapping

    width, height = from_mapping(options).layout.camera_size
    return width, height


def rig_of(made: RigDevices) -> Rig:
    return Rig(
        made.cameras,
        made.projector,
        calibration.from_mapping(made.calibration),
        color_fringe.from_mapping(made.pattern),
        Volume(**made.volume),
        b"x",
        "sha256:00",
        made.close,
    )


def config(tmp_path: Path, extra: str = "") -> RigConfig:
    return parse_rig(
        f"cameras: {{driver: sim}}\nstream: {{endpoints: ['ipc://{tmp_path}/s']}}\n"
        f"control: {{endpoint: 'ipc://{tmp_path}/c'}}\n" + extra
    )


class Collector:
    """A sink that keeps everything, or rejects everything."""

    heartbeat: Heartbeat | None = None

    def __init__(self, *, full: bool = False) -> None:
        self.items: list[Item] = []
        self.full, self.closed, self.problem = full, False, ""

    def offer(self, item: Item) -> bool:
        if self.full:
            return False
        self.items.append(item)
        return True

    def close(self) -> None:
        self.closed = True

    def status(self) -> dict[str, Any]:
        return {"items": len(self.items), "problem": self.problem}

    @property
    def clouds(self) -> list[CloudItem]:
        return [item for item in self.items if isinstance(item, CloudItem)]

    @property
    def pairs(self) -> list[Pair]:
        return [item for item in self.items if isinstance(item, Pair)]
