"""Small takes for the tests."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from daemon.live.items import Pair, UnpairedFrame
from daemon.recording.read.take_reader import TakePair, TakeReader
from daemon.recording.write.take_writer import TakeWriter
from drivers.protocols import Frame, Side

CALIBRATION = b"fringed_calibration: 1  # byte for byte\n"
T0_NS = 1_790_000_000_123_456_789
SIZE = (26, 32)


def frame(side: Side, number: int, *, encoding: str = "rgb8", size: tuple[int, int] = SIZE) -> Frame:
    """An image of noise that its side and number determine."""
    rng = np.random.default_rng([number, side == "left"])
    if encoding == "mono16":
        image: Any = rng.integers(0, 65536, size, dtype=np.uint16)
    else:
        image = rng.integers(0, 256, (*size, 3) if encoding == "rgb8" else size, dtype=np.uint8)
    image.setflags(write=False)
    late_ns = 1_000_000 * (1 + (side == "right"))
    t_ns = T0_NS + number % 1000 * 33_000_000
    return Frame(side, number, t_ns, t_ns + late_ns, encoding, image)


def pair(number: int, **options: Any) -> Pair:
    """Both frames of a trigger."""
    return Pair(frame("left", number, **options), frame("right", number, **options))


def unpaired(side: Side, number: int) -> UnpairedFrame:
    """A frame without its partner."""
    return UnpairedFrame(frame(side, number))


def writer(path: Path, **options: Any) -> TakeWriter:
    """A writer with everything a take carries."""
    values: dict[str, Any] = {"session": "a session", "device": "rig-01", "calibration_data": CALIBRATION}
    values |= {"pattern": {"kind": "color_fringe"}, "volume": {"near_mm": 1200, "far_mm": 1700}}
    return TakeWriter(path, **(values | {"min_free_bytes": 0, "queue": 1000} | options))


def write(path: Path, items: list[Any], **options: Any) -> dict[str, Any]:
    """A finished take; returns the writer's last status."""
    recorder = writer(path, **options)
    for item in items:
        assert recorder.offer(item)
    recorder.close()
    return recorder.status()


def pairs_of(path: Path) -> list[TakePair]:
    """Every pair of a take."""
    with TakeReader(path) as take:
        return list(take.pairs())
