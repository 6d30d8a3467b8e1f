"""Statistics of pairs and clouds over the last minute; adding one is cheap, evaluation is done once a second."""

from __future__ import annotations

from collections import deque
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from daemon.live.items import CloudItem, Pair
from drivers.protocols import TRIGGER_MODULUS

KEPT = 8192
_MOST_SKIPPED = 1000  # triggers between two pairs that still define the interval
_ENOUGH = 4

T = TypeVar("T")


class _Pair(NamedTuple):
    now_ns: int
    seq: int
    t_ns: int
    residual_ns: int


class _Cloud(NamedTuple):
    now_ns: int
    latency_ms: float
    arrival_ms: float
    stages: dict[str, float]


class FrameStatistics:
    """The pairs and clouds of the last minute. No lock: the adding threads never wait for the evaluation."""

    def __init__(self) -> None:
        self._pairs: deque[_Pair] = deque(maxlen=KEPT)
        self._clouds: deque[_Cloud] = deque(maxlen=KEPT)

    def pair(self, item: Pair, now_ns: int) -> None:
        """Add a pair."""
        t_ns = item.left.t_exposure_ns
        self._pairs.append(_Pair(now_ns, item.left.trigger, t_ns, item.right.t_exposure_ns - t_ns))

    def cloud(self, item: CloudItem, now_ns: int) -> None:
        """Add a cloud."""
        arrival_ms = item.latency_ms - (item.t_arrived_ns - item.t_ns) / 1e6
        self._clouds.append(_Cloud(now_ns, item.latency_ms, arrival_ms, item.cloud.ms))

    def clear(self) -> None:
        """Remove all pairs and clouds."""
        self._pairs.clear()
        self._clouds.clear()

    def values(self, now_ns: int, window_s: float) -> dict[str, float]:
        """Return latency, residual and jitter over a window; unknown values are left out."""
        pairs, clouds = self._recent(now_ns, window_s)
        out = _timing(pairs)
        if clouds:
            latency = np.array([(cloud.latency_ms, cloud.arrival_ms) for cloud in clouds])
            p50, p99 = percentiles(latency[:, 0], (0.5, 0.99))
            out |= {"latency_p50_ms": p50, "latency_p99_ms": p99}
            out["arrival_p99_ms"] = percentiles(latency[:, 1], (0.99,))[0]
        return out

    def window(self, now_ns: int, window_s: float) -> dict[str, Any]:
        """Return counts and the percentiles of latency and of every stage."""
        pairs, clouds = self._recent(now_ns, window_s)
        stages = sorted({name for cloud in clouds for name in cloud.stages})
        return {
            "seconds": window_s,
            "pairs": len(pairs),
            "clouds": len(clouds),
            "latency_ms": spread([cloud.latency_ms for cloud in clouds]),
            "arrival_ms": spread([cloud.arrival_ms for cloud in clouds]),
            "stages_ms": {
                name: spread([cloud.stages[name] for cloud in clouds if name in cloud.stages]) for name in stages
            },
            **{name: round(value, 3) for name, value in _timing(pairs).items()},
        }

    def _recent(self, now_ns: int, window_s: float) -> tuple[list[_Pair], list[_Cloud]]:
        since_ns = now_ns - round(1e9 * window_s)
        pairs, clouds = snapshot(self._pairs), snapshot(self._clouds)
        return [p for p in pairs if p.now_ns > since_ns], [c for c in clouds if c.now_ns > since_ns]


def snapshot(rows: deque[T]) -> list[T]:
    """Return the rows of a queue that other threads fill."""
    while True:
        try:
            return list(rows)
        except RuntimeError:  # a row was added during the copy
            continue


def percentiles(values: NDArray[np.float64], shares: tuple[float, ...]) -> list[float]:
    """Return the values that these shares of them do not exceed."""
    ordered = np.sort(values)
    return [float(ordered[min(len(ordered) - 1, int(share * len(ordered)))]) for share in shares]


def spread(values: list[float]) -> dict[str, float]:
    """Return p50, p95, p99 and max; empty without values."""
    if not values:
        return {}
    points = percentiles(np.array(values), (0.5, 0.95, 0.99, 1.0))
    return {name: round(value, 3) for name, value in zip(("p50", "p95", "p99", "max"), points, strict=True)}


def _timing(pairs: list[_Pair]) -> dict[str, float]:
    if not pairs:
        return {}
    residual = np.array([pair.residual_ns for pair in pairs], dtype=np.float64) / 1e3
    middle = float(np.median(residual))
    out = {"pairing_residual_us": middle, "pairing_spread_us": float(np.abs(residual - middle).max())}
    return out | _interval(pairs)


def _interval(pairs: list[_Pair]) -> dict[str, float]:
    """Return median and scatter of the interval between triggers; lost ones are counted by their numbers."""
    seq = np.array([pair.seq for pair in pairs], dtype=np.int64)
    t_ns = np.array([pair.t_ns for pair in pairs], dtype=np.int64)
    steps, times = np.diff(seq) % TRIGGER_MODULUS, np.diff(t_ns)
    good = (steps >= 1) & (steps <= _MOST_SKIPPED) & (times > 0)
    if np.count_nonzero(good) < _ENOUGH:
        return {}
    steps, times = steps[good], times[good].astype(np.float64)
    interval = float(np.median(times / steps))
    return {"trigger_interval_ms": interval / 1e6, "trigger_jitter_us": float(np.std(times - steps * interval)) / 1e3}
