"""A simulated rig whose projector shows anything and whose cameras see how bright that is."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daemon.live.service import Service
from drivers.errors import DriverError
from drivers.protocols import ProjectorInfo
from pipeline.reconstruct.cloud import Cloud
from sim.devices.open_rig import RigDevices, open_rig
from sim.devices.trigger_world import SimWorld
from tests.daemon.rigs import SMALL, open_rig_size


class FreeProjector:
    """Shows every image at once; its latency is known."""

    def __init__(self, size: tuple[int, int]) -> None:
        self.size, self.level, self.trouble = size, 0, ""
        self.shown: list[int] = []
        self.lit = True

    def open(self) -> ProjectorInfo:
        return ProjectorInfo("free", self.size, 0.0, latency_s=0.0)

    def show(self, image: Any) -> None:
        if self.trouble:
            raise DriverError(self.trouble)
        self.level = int(image[0, 0].max())
        self.shown.append(self.level)

    def problem(self) -> str:
        return self.trouble

    def close(self) -> None:
        self.level = 0


class Lit:
    """Images as bright as what is projected."""

    def __init__(self, size: tuple[int, int], projector: FreeProjector) -> None:
        self._size, self._projector = size, projector

    def pair(self, index: int) -> tuple[Any, Any]:  # noqa: ARG002 - the protocol's
        image = np.full((*self._size[::-1], 3), self._projector.level, np.uint8)
        image.setflags(write=False)
        return image, image


def devices(rate_hz: float = 200.0) -> tuple[RigDevices, FreeProjector, SimWorld]:
    """The rig, giving triggers in real time."""
    options = SMALL | {"rate_hz": rate_hz}
    size = open_rig_size(options)
    plain = open_rig(options, Path(), images=Lit(size, FreeProjector((1, 1))))
    projector = FreeProjector(plain.options.layout.projector_size)
    world = SimWorld(Lit(size, projector), projector, size, "rgb8", rate_hz=rate_hz, exposure_us=500.0)  # type: ignore[arg-type]
    made = RigDevices(world.cameras, projector, world, plain.options, plain.calibration, plain.pattern, plain.volume)
    return made, projector, world


class FlatReconstructor:
    """Gives a cloud without any point, and compiles nothing."""

    mode = "single"
    warnings = ()

    def warm_up(self, *, strides: tuple[int, ...], use_prior: bool) -> None:
        pass

    def reconstruct(self, left: Any, right: Any, *, stride: int = 1, use_prior: bool = False) -> Cloud:  # noqa: ARG002
        shape = left.shape[:2]
        xyz, sigma = np.full((*shape, 3), np.nan, np.float32), np.full(shape, np.nan, np.float32)
        dark = np.zeros(shape, np.uint8)
        return Cloud(xyz, sigma, dark, (dark, dark), np.full(shape, -1, np.int16))


class UnmeasuringService(Service):
    """The daemon without its pipeline."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        super().__init__(*arguments, **options)
        self.path.warm_reconstructor = FlatReconstructor  # type: ignore[assignment]
