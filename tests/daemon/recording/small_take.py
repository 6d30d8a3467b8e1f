"""A take of the small simulated rig: three scenes, 128 x 102 pixels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from daemon.live.items import Pair
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame
from sim.rig import rig_files
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene import named_scenes
from tests.renders import render_pair

LAYOUT = RigLayout().scaled(0.125)
OPTICS = Optics()
SCENES = ("plane", "spheres", "face")
CALIBRATION = yaml.safe_dump(rig_files.calibration_mapping(LAYOUT, OPTICS), sort_keys=False).encode()

Images = tuple[NDArray[np.uint8], NDArray[np.uint8]]


def render() -> list[Images]:
    """Left and right image of every scene."""
    pairs = [render_pair(LAYOUT, named_scenes.build(name), LAYOUT.pattern(), OPTICS) for name in SCENES]
    return [(pair.left, pair.right) for pair in pairs]


def at_rest(images: Images, count: int) -> list[Images]:
    """The same pair with other noise each time; without any, clouds of a scene at rest would be equal."""
    rng = np.random.default_rng(4)
    left, right = ([image + rng.integers(0, 3, image.shape, np.uint8) for _ in range(count)] for image in images)
    return list(zip(left, right, strict=True))


def write(path: Path, images: Sequence[Images], *, first: int = 40, **options: Any) -> Path:
    """A take of these images, numbered from ``first``."""
    values: dict[str, Any] = {"session": "small", "device": "sim", "calibration_data": CALIBRATION}
    values |= {"pattern": rig_files.pattern_mapping(LAYOUT), "volume": rig_files.volume_mapping(LAYOUT)}
    recorder = TakeWriter(path, **(values | {"min_free_bytes": 0, "queue": 100} | options))
    for number, (left, right) in enumerate(images, first):
        t_ns = 1_790_000_000_000_000_000 + 250_000_000 * number
        frames = [
            Frame(side, number, t_ns, t_ns + 10_000_000, "rgb8", image)
            for side, image in (("left", left), ("right", right))
        ]
        assert recorder.offer(Pair(*frames))
    recorder.close()
    assert "problem" not in recorder.status()
    return path
