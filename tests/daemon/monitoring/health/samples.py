"""Statuses, pairs and clouds that were not measured, and a clock that the test advances."""

from __future__ import annotations

from typing import Any

import numpy as np

from daemon.config.sections.health import Health as Config
from daemon.config.sections.health import HealthLimits
from daemon.live.items import CloudItem, Pair
from drivers.protocols import Frame, Side
from pipeline.reconstruct.cloud import Cloud

REAL_NS = 1_700_000_000_000_000_000
SIZE = (64, 48)


class Clock:
    """Stands still until it is advanced."""

    def __init__(self) -> None:
        self.now_ns = 5_000_000_000

    def monotonic_ns(self) -> int:
        return self.now_ns

    def realtime_ns(self) -> int:
        return REAL_NS + self.now_ns

    def move(self, seconds: float) -> None:
        self.now_ns += round(1e9 * seconds)


def config(*, limits: dict[str, Any] | None = None, **values: Any) -> Config:
    return Config(**values, limits=HealthLimits(**(limits or {})))


def frame(side: Side, seq: int, t_ns: int, image: Any = None) -> Frame:
    if image is None:
        image = np.full((SIZE[1], SIZE[0], 3), 90, np.uint8)
    return Frame(side, seq % (1 << 32), t_ns, t_ns + 8_000_000, "rgb8", image)


def pair(seq: int, t_ns: int, *, residual_ns: int = 0) -> Pair:
    return Pair(frame("left", seq, t_ns), frame("right", seq, t_ns + residual_ns))


def cloud(seq: int, t_ns: int, *, latency_ms: float = 30.0, ms: dict[str, float] | None = None) -> CloudItem:
    width, height = SIZE
    plane = np.full((height, width), 50, np.uint8)
    known = np.zeros((height, width, 3), np.float32)
    made = Cloud(known, known[..., 0], plane, (plane, plane), np.zeros((height, width), np.int16), ms=ms or {})
    return CloudItem(seq, t_ns, made, frame("left", seq, t_ns), frame("right", seq, t_ns), latency_ms=latency_ms)


def camera(**values: Any) -> dict[str, Any]:
    return {"temperature_c": None, "fates": {"paired": 0, "waiting": 0}} | values


def status(**values: Any) -> dict[str, Any]:
    """A service's status, as far as it is evaluated."""
    plain: dict[str, Any] = {
        "state": "running", "reasons": (), "device": "rig-t", "t_ns": REAL_NS, "uptime_s": 1.0, "pairs": 0, "clouds": 0,
        "pair_rate_hz": 10.0, "cloud_rate_hz": 10.0, "valid": 0.8, "drops": {},
        "cameras": {"left": camera(), "right": camera()},
    }  # fmt: skip
    return plain | values
