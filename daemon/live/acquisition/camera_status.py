"""State and status of one camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum


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
        losses: how often the device was lost; fates: outcomes of the frames that the driver delivered, counted.
        driver: the driver's counters, frames that it lost among them.
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
