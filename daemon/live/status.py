"""State and status of the daemon.

States::

    starting --> running <--> degraded          degraded: a camera is gone, a sink has a problem, ...
        |           |             |             paused: by request; everything stays connected
        |           +--> paused <-+
        +-----------+------+------+--> stopping
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from daemon.live.acquisition.camera_status import CameraStatus
from daemon.live.items import SINGLE


class State(StrEnum):
    """What the daemon is doing."""

    STARTING = "starting"
    RUNNING = "running"
    DEGRADED = "degraded"
    PAUSED = "paused"
    STOPPING = "stopping"


@dataclass(frozen=True, slots=True)
class Status:
    """The whole daemon at one moment.

    Args:
        reasons: why it is degraded; warnings: what measures, but not as well as it could.
        measured_every: spacing of the measured pixels; 2 while an overloaded pipeline skips every second one.
        latency_ms: from the start of exposure to the finished cloud.
        publish_latency_ms: from the arrival of both frames to the handing over of the cloud to the stream, empty while
            no subscriber reads clouds. Both over the last ten minutes or so.
        calibration_check: policy, verdict on the last pair, reason, readings, and the number of withheld clouds.
        selfcheck: whether the calibration still fits: the verdict and every observable; only ``enabled: false`` when
            it is switched off.
        health: the verdict and what is beyond its limits; only ``enabled: false`` when it is switched off.
        mode: single, or the name of a multi-frame mode; sequence: its images and sets.
        kernels: jobs of the compilation, those that are ready and all, while the daemon starts or changes its mode.
        processors: share of the processor time that the daemon wanted and got over the last seconds, and the seconds
            that other programs took from it since the start.
        drops: everything that was dropped, by reason; drops_starting: the part of it before the daemon measured.
        garbage: runs of Python's garbage collector since the start, and how long they stopped all threads.
        memory: page faults since the daemon measures, those while one pair is measured, and growth of Python's objects.
        slowest: times of the pair with the longest latency of the last five to ten minutes.
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
    memory: dict[str, float]
    slowest: dict[str, Any]
    processors: dict[str, float]
    calibration_check: dict[str, Any]
    drops: dict[str, int]
    drops_starting: dict[str, int]
    cameras: dict[str, CameraStatus]
    sinks: dict[str, dict[str, Any]]
    recorder: dict[str, Any]
    selfcheck: dict[str, Any]
    health: dict[str, Any]
    mode: str = SINGLE
    sequence: dict[str, Any] = field(default_factory=dict)
    kernels: dict[str, int] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Plain values for JSON."""
        return asdict(self)
