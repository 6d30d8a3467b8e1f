"""What the daemon says of itself.

States::

    starting --> running <--> degraded          degraded: a camera is gone, a sink has a problem, ...
        |           |             |             paused: told to stop measuring; everything stays connected
        |           +--> paused <-+
        +-----------+------+------+--> stopping
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any


class State(StrEnum):
    """What the daemon is doing."""

    STARTING = "starting"
    RUNNING = "running"
    DEGRADED = "degraded"
    PAUSED = "paused"
    STOPPING = "stopping"


class CameraState(StrEnum):
    """What a camera's thread is doing."""

    CLOSED = "closed"
    ACQUIRING = "acquiring"
    PAUSED = "paused"
    LOST = "lost"


@dataclass(frozen=True, slots=True)
class CameraStatus:
    """One camera, as its thread sees it.

    Args:
        losses: times the device was gone; fates: what became of the frames that the driver delivered.
        driver: what the driver counts, frames that it lost among it.
    """

    state: CameraState
    model: str = ""
    serial: str = ""
    encoding: str = ""
    size: tuple[int, int] = (0, 0)
    exposure_us: float = 0.0
    problem: str = ""
    losses: int = 0
    rate_hz: float = 0.0
    frames: int = 0
    fates: dict[str, int] = field(default_factory=dict)
    driver: dict[str, int] = field(default_factory=dict)
    temperature_c: float | None = None


@dataclass(frozen=True, slots=True)
class Status:
    """The whole daemon at one moment.

    Args:
        reasons: why it is degraded; warnings: what measures, but not as well as it could.
        measured_every: spacing of the measured pixels; 2 while an overloaded pipeline skips every second one.
        latency_ms: from the start of exposure to the finished cloud.
        publish_latency_ms: from the arrival of both frames to the handing over of the cloud to the stream, empty while
            nobody reads clouds. Both over the last ten minutes or so.
        selfcheck: whether the calibration still fits: the verdict and every observable; only ``enabled: false`` when
            nobody looks.
        health: the verdict and what is beyond its limits; only ``enabled: false`` when nobody judges.
        mode: single, or the name of a multi-frame mode; sequence: its images and sets.
        garbage: collections of Python's garbage since the start, and how long they held everything up.
    """

    state: State
    reasons: tuple[str, ...]
    warnings: tuple[str, ...]
    device: str
    session: str
    version: str
    pid: int
    t_ns: int
    uptime_s: float
    calibration: str
    pairs: int
    clouds: int
    pair_rate_hz: float
    cloud_rate_hz: float
    points: int
    valid: float
    measured_every: int
    latency_ms: dict[str, float]
    publish_latency_ms: dict[str, float]
    stages_ms: dict[str, float]
    garbage: dict[str, float]
    drops: dict[str, int]
    cameras: dict[str, CameraStatus]
    sinks: dict[str, dict[str, Any]]
    recorder: dict[str, Any]
    selfcheck: dict[str, Any]
    health: dict[str, Any]
    mode: str = "single"
    sequence: dict[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)
