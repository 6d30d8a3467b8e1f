"""The history of the last hours in memory: every second of the last hour, every minute before; a few megabytes."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

SECONDS = 3600
_MINUTE = 60


class Ring:
    """A ring buffer of rows of numbers with their times.

    Args:
        rows: kept at most; width: numbers in a row.
    """

    def __init__(self, rows: int, width: int) -> None:
        self._times = np.zeros(rows)
        self._values = np.zeros((rows, width), np.float32)
        self._count = 0

    @property
    def nbytes(self) -> int:
        """Bytes of memory in use."""
        return self._times.nbytes + self._values.nbytes

    def __len__(self) -> int:
        return min(self._count, len(self._times))

    def add(self, t_s: float, row: Array) -> None:
        """Add a row."""
        slot = self._count % len(self._times)
        self._times[slot], self._values[slot] = t_s, row
        self._count += 1

    def since(self, t_s: float, columns: list[int]) -> tuple[NDArray[np.float64], Array]:
        """Return times and chosen columns of the rows after a time, in order."""
        order = np.arange(self._count - len(self), self._count) % len(self._times)
        order = order[self._times[order] > t_s]
        return self._times[order], self._values[order][:, columns]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A section of the history in equal intervals.

    Args:
        times_s: (n,) middles of the intervals, monotonic seconds; period_s: their length.
        mean, low, high: (n, k) of k quantities, NaN where all values are unknown.
    """

    times_s: NDArray[np.float64]
    period_s: float
    mean: Array
    low: Array
    high: Array


class History:
    """Seconds and minutes of ``width`` quantities.

    Args:
        hours: covered by the minutes.
    """

    def __init__(self, width: int, hours: float) -> None:
        self._width = width
        self._seconds = Ring(SECONDS, width)
        self._minutes = Ring(max(2, round(60 * hours)), 3 * width)
        self._minute: list[Array] = []
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Bytes of memory in use."""
        return self._seconds.nbytes + self._minutes.nbytes

    @property
    def rows(self) -> tuple[int, int]:
        """Numbers of kept seconds and minutes."""
        return len(self._seconds), len(self._minutes)

    def add(self, t_s: float, row: Array) -> None:
        """Add a second; a minute is summarised when it is full."""
        with self._lock:
            self._seconds.add(t_s, row)
            self._minute.append(row)
            if len(self._minute) >= _MINUTE:
                self._minutes.add(t_s - _MINUTE / 2, np.concatenate(summarised(np.stack(self._minute))))
                self._minute = []

    def read(self, now_s: float, span_s: float, columns: list[int], most: int) -> Series:
        """Return the last ``span_s`` in at most ``most`` intervals, none shorter than the kept rows."""
        with self._lock:
            if span_s <= SECONDS:
                times, values = self._seconds.since(now_s - span_s, columns)
                low, high, row_s = values, values, 1.0
            else:
                times, values, low, high = self._long(now_s - span_s, columns)
                row_s = float(_MINUTE)
        # An interval spans at least one and a half rows, so that slightly late rows leave no gaps.
        intervals = max(1, min(most, int(span_s / (1.5 * row_s))))
        return binned(times, (values, low, high), now_s - span_s, span_s, intervals)

    def _long(self, since_s: float, columns: list[int]) -> tuple[NDArray[np.float64], Array, Array, Array]:
        """Return the minutes and a summary of the seconds of the unfinished one."""
        w = self._width
        times, rows = self._minutes.since(since_s, [c + k * w for k in range(3) for c in columns])
        mean, low, high = np.split(rows, 3, axis=1)
        if self._minute:
            newest, _ = self._seconds.since(since_s, columns)
            parts = summarised(np.stack(self._minute)[:, columns])
            times = np.append(times, newest[-len(self._minute) :].mean())
            mean, low, high = (np.vstack([a, b]) for a, b in zip((mean, low, high), parts, strict=True))
        return times, mean, low, high


def summarised(rows: Array) -> tuple[Array, Array, Array]:
    """Return mean, minimum and maximum of the finite values of each column, NaN where there are none."""
    finite = np.isfinite(rows)
    count = finite.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(finite, rows, 0).sum(axis=0) / count
    mean[count == 0] = np.nan
    return mean.astype(np.float32), np.fmin.reduce(rows, axis=0), np.fmax.reduce(rows, axis=0)


def binned(
    times: NDArray[np.float64], rows: tuple[Array, Array, Array], begin_s: float, span_s: float, intervals: int
) -> Series:
    """Summarise rows of mean, low and high in intervals of equal length."""
    period = span_s / intervals
    width = rows[0].shape[1]
    out = [np.full((intervals, width), np.nan, np.float32) for _ in range(3)]
    index = np.clip(((times - begin_s) / period).astype(int), 0, intervals - 1)
    for i in np.unique(index):
        chosen = index == i
        out[0][i] = summarised(rows[0][chosen])[0]
        out[1][i] = np.fmin.reduce(rows[1][chosen], axis=0)
        out[2][i] = np.fmax.reduce(rows[2][chosen], axis=0)
    middles: NDArray[np.float64] = begin_s + period * (np.arange(intervals, dtype=np.float64) + 0.5)
    return Series(middles, period, *out)
