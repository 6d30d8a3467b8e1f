"""The latency measured by a flash is that of the simulated projector, for any triggers."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import pytest

from daemon.live.projection.latency_measurement import measure_latency
from drivers.errors import DriverError
from drivers.protocols import CameraHealth, CameraInfo, Flip, Frame, ProjectorInfo

NOW_NS = 1_700_000_000_000_000_000


class Bench:
    """Time, light and triggers: time passes only while a frame is waited for or an image is flipped."""

    def __init__(self, *, latency_ms: float, period_ms: float, refresh_hz: float = 60.0, white: float = 180.0) -> None:
        self.now_ns, self.latency_ns, self.period_ns = NOW_NS, round(1e6 * latency_ms), round(1e6 * period_ms)
        self.refresh_hz, self.white = refresh_hz, white
        self.changes: list[tuple[int, int]] = [(0, 0)]
        self.triggers = 0
        self.cameras = {"left": BenchCamera(self), "right": BenchCamera(self)}
        self.closed = self.flip_ago_ns = 0

    def realtime_ns(self) -> int:
        return self.now_ns

    def monotonic_ns(self) -> int:
        return self.now_ns - NOW_NS

    def level(self, t_ns: int) -> float:
        return [level for since, level in self.changes if since <= t_ns][-1] * self.white / 255 + 12.0

    def pass_until(self, t_ns: int) -> None:
        while NOW_NS + self.triggers * self.period_ns <= t_ns:
            at = NOW_NS + self.triggers * self.period_ns
            for camera in self.cameras.values():
                camera.queue.append((self.triggers, at, self.level(at)))
            self.triggers += 1
        self.now_ns = max(self.now_ns, t_ns)

    def open(self) -> ProjectorInfo:
        return ProjectorInfo("bench", (32, 24), self.refresh_hz)

    def show(self, image: Any) -> Flip | None:
        assert image.shape == (24, 32, 3)
        self.pass_until(self.now_ns + 7_300_000)
        self.changes.append((self.now_ns + self.latency_ns, int(image[0, 0, 0])))
        return (
            Flip(self.now_ns - self.flip_ago_ns - NOW_NS, self.now_ns - self.flip_ago_ns, 1, "present")
            if self.flip_ago_ns
            else None
        )

    def problem(self) -> str:
        return ""

    def close(self) -> None:
        self.closed += 1


class BenchCamera:
    def __init__(self, bench: Bench) -> None:
        self.bench, self.queue, self.deaf = bench, deque[tuple[int, int, float]](), False

    def open(self) -> CameraInfo:
        return CameraInfo("bench", "1", (16, 8), "mono8")

    def start(self) -> None:
        self.queue.clear()

    def read(self, timeout_s: float) -> Frame | None:
        if not self.queue or self.deaf:
            self.bench.pass_until(self.bench.now_ns + round(1e9 * timeout_s))
        if not self.queue or self.deaf:
            return None
        number, t_ns, level = self.queue.popleft()
        image = np.full((8, 16), level, np.uint8)
        return Frame("left", number, t_ns, t_ns, "mono8", image)

    def stop(self) -> None:
        pass

    def close(self) -> None:
        self.bench.closed += 1

    def health(self) -> CameraHealth:
        return CameraHealth()


def measured(bench: Bench, **options: Any) -> Any:
    return measure_latency(bench.cameras, bench, clock=bench, **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("latency_ms", [0.4, 16.7, 33.4, 50.0])
@pytest.mark.parametrize("period_ms", [5.0, 16.68, 33.37])
def test_the_bounds_hold_the_truth_and_the_estimate_is_within_half_a_period(
    latency_ms: float, period_ms: float
) -> None:
    bench = Bench(latency_ms=latency_ms, period_ms=period_ms)
    found = measured(bench)
    assert found.earliest_ms <= latency_ms + 1e-6
    assert latency_ms <= found.latest_ms + 1e-6
    assert found.ms == pytest.approx(latency_ms, abs=0.51 * period_ms)
    assert found.frames == pytest.approx(found.ms * 60 / 1000, abs=0.01)
    assert found.dark == pytest.approx(12, abs=0.1)
    assert found.bright == pytest.approx(192, abs=0.1)
    assert bench.closed == 3


def test_a_driver_that_knows_the_flip_is_believed() -> None:
    bench = Bench(latency_ms=20.0, period_ms=2.0)
    bench.flip_ago_ns = 4_000_000
    found = measured(bench)
    assert found.ms == pytest.approx(24.0, abs=1.1)


def test_an_undetected_flash_and_missing_frames_are_errors_and_everything_is_closed() -> None:
    dark = Bench(latency_ms=1.0, period_ms=10.0, white=5.0)
    with pytest.raises(DriverError, match=r"the flash is not seen \(the dark image has 12\.0 counts\)"):
        measured(dark)
    deaf = Bench(latency_ms=1.0, period_ms=10.0)
    deaf.cameras["right"].deaf = True
    with pytest.raises(DriverError, match=r"camera right: no frame comes; is the trigger wired"):
        measured(deaf)
    assert dark.closed == deaf.closed == 3
