"""Measurement of a projector's latency: from the flip of an image to the first exposure that sees it.

A black and a white image are shown in turn. The cameras go on being triggered; the first frame that is brighter than
half way from dark to white saw the flash. The light came between the exposure before it and this one, so the triggers'
period limits what a single flash shows; several flashes at unrelated moments narrow it down.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from statistics import mean, median

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError
from drivers.protocols import Camera, Clock, Frame, Projector, Side

_STEADY = 3
"""Frames in a row of about the same brightness that end a change of the image."""
_SAME = 0.1
"""Tolerance of equal brightness, as a share of the step from dark to white."""
MAX_LATENCY_NS = 300_000_000
"""Upper bound of any projector's latency."""
_LEAST_STEP_DN = 8.0
_READ_S = 0.2
_SHARE = np.s_[::4, ::4]


@dataclass(frozen=True, slots=True)
class Latency:
    """Result of the measurement.

    Args:
        ms: median of the middles between the last dark exposure and the first bright one, after the flip.
        earliest_ms, latest_ms: bounds that all flashes agree with; earliest above latest: they do not agree.
        flashes: how many were shown; frames: ``ms`` in periods of the projector, 0 where its rate is unknown.
        dark, bright: mean counts of a frame.
    """

    ms: float
    earliest_ms: float
    latest_ms: float
    flashes: int
    frames: float
    dark: float
    bright: float


def measure_latency(
    cameras: Mapping[Side, Camera],
    projector: Projector,
    *,
    clock: Clock,
    flashes: int = 7,
    timeout_s: float = 5.0,
) -> Latency:
    """Show flashes and measure the brightness; opens the projector and the cameras, and closes them.

    Args:
        timeout_s: longest wait for a change of the image to be seen.

    Raises:
        DriverError: no frames come, or the flash is not seen.
    """
    try:
        info = projector.open()
        for camera in cameras.values():
            camera.open()
        width, height = info.size
        black, white = (np.full((height, width, 3), level, np.uint8) for level in (0, 255))
        meters = [_LightMeter(side, camera, clock, timeout_s) for side, camera in cameras.items()]
        for camera in cameras.values():
            camera.start()
        measurements = _flash(meters, projector, (black, white), clock, flashes)
    finally:
        for camera in cameras.values():
            camera.close()
        projector.close()
    middles = [0.5 * (low + high) for low, high, _, _ in measurements]
    ms = max(0.0, median(middles))  # below: the flip is known less well than the latency
    return Latency(
        ms=round(ms, 2),
        earliest_ms=round(max(low for low, _, _, _ in measurements), 2),
        latest_ms=round(min(high for _, high, _, _ in measurements), 2),
        flashes=flashes,
        frames=round(ms * info.refresh_hz / 1e3, 2),
        dark=round(mean(dark for _, _, dark, _ in measurements), 1),
        bright=round(mean(bright for _, _, _, bright in measurements), 1),
    )


def _flash(
    meters: list[_LightMeter],
    projector: Projector,
    images: tuple[NDArray[np.uint8], NDArray[np.uint8]],
    clock: Clock,
    flashes: int,
) -> list[tuple[float, float, float, float]]:
    """Bounds in ms, dark and bright counts of every flash and camera."""
    measurements = []
    for _ in range(flashes):
        projector.show(images[0])
        shown_ns = clock.realtime_ns()
        dark = [meter.dark(shown_ns + MAX_LATENCY_NS) for meter in meters]
        flip = projector.show(images[1])
        flipped_ns = clock.realtime_ns() if flip is None or flip.source == "unverified" else flip.t_realtime_ns
        for meter, level in zip(meters, dark, strict=True):
            before_ns, after_ns, bright = meter.brighter(level)
            measurements.append(((before_ns - flipped_ns) / 1e6, (after_ns - flipped_ns) / 1e6, level, bright))
    return measurements


class _LightMeter:
    """Mean brightness of one camera's frames."""

    def __init__(self, side: Side, camera: Camera, clock: Clock, timeout_s: float) -> None:
        self._side, self._camera, self._clock = side, camera, clock
        self._timeout_ns = round(1e9 * timeout_s)
        self._last_ns = 0

    def dark(self, since_ns: int) -> float:
        """The steady brightness of exposures from then on."""

        def settled(levels: list[float]) -> bool:
            return _is_steady(levels, _LEAST_STEP_DN / 2)

        problem = "its image goes on changing; is the light of the room steady?"
        frames, levels = self._until(settled, problem, since_ns)
        self._last_ns = frames[-1].t_exposure_ns
        return levels[-1]

    def brighter(self, dark: float) -> tuple[int, int, float]:
        """Start of the last exposure before the flash and of the first one with it, and the settled brightness."""

        def settled(levels: list[float]) -> bool:
            step = levels[-1] - dark
            return step > _LEAST_STEP_DN and _is_steady(levels, _SAME * step)

        frames, levels = self._until(settled, f"the flash is not seen (the dark image has {dark:.1f} counts)")
        first = next(i for i, level in enumerate(levels) if level > 0.5 * (dark + levels[-1]))
        after_ns = frames[first].t_exposure_ns
        before_ns = frames[first - 1].t_exposure_ns if first > 0 else self._last_ns
        return before_ns, after_ns, levels[-1]

    def _until(
        self, enough: Callable[[list[float]], bool], problem: str, since_ns: int = 0
    ) -> tuple[list[Frame], list[float]]:
        end_ns = self._clock.monotonic_ns() + self._timeout_ns
        frames: list[Frame] = []
        levels: list[float] = []
        while self._clock.monotonic_ns() < end_ns:
            frame = self._camera.read(_READ_S)
            if frame is None or frame.t_exposure_ns < since_ns:
                continue
            frames.append(frame)
            levels.append(float(frame.image[_SHARE].mean()))
            if enough(levels):
                return frames, levels
        if not frames:
            problem = "no frame comes; is the trigger wired, and does the projector give pulses?"
        raise DriverError(f"camera {self._side}: {problem}; waited {self._timeout_ns / 1e9:g} s")


def _is_steady(levels: list[float], within: float) -> bool:
    last = levels[-_STEADY:]
    return len(last) == _STEADY and max(last) - min(last) <= within
