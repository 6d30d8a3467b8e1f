"""The last hours in memory: every second of the last hour, every minute of the hours before; a few megabytes."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float32]

SECONDS = 3600
_MINUTE = 60


class Ring:
    """Rows of numbers with the time of each; the oldest go.

    Args:
        rows: kept; width: numbers in a row.
    """

    def __init__(self, rows: int, width: int) -> None:
        self._times = np.zeros(rows)
        self._values = np.zeros((rows, width), np.float32)
        self._count = 0

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        return self._times.nbytes + self._values.nbytes

    def __len__(self) -> int:
        return min(self._count, len(self._times))

    def add(self, t_s: float, row: Array) -> None:
        """Add a row."""
        place = self._count % len(self._times)
        self._times[place], self._values[place] = t_s, row
        self._count += 1

    def since(self, t_s: float, columns: list[int]) -> tuple[NDArray[np.float64], Array]:
        """Times and chosen columns of the rows after a time, in order."""
        order = np.arange(self._count - len(self), self._count) % len(self._times)
        order = order[self._times[order] > t_s]
        return self._times[order], self._values[order][:, columns]


@dataclass(frozen=True, slots=True, eq=False)
class Series:
    """A stretch of the history, cut into equal pieces.

    Args:
        times_s: (n,) middles of the pieces, monotonic seconds; period_s: their length.
        mean, low, high: (n, k) of k quantities, NaN where nothing is known.
    """

    times_s: NDArray[np.float64]
    period_s: float
    mean: Array
    low: Array
    high: Array


class History:
    """Seconds and minutes of ``width`` quantities.

    Args:
        hours: for which minutes are kept.
    """

    def __init__(self, width: int, hours: float) -> None:
        self._width = width
        self._seconds = Ring(SECONDS, width)
        self._minutes = Ring(max(2, round(60 * hours)), 3 * width)
        self._minute: list[Array] = []
        self._lock = threading.Lock()

    @property
    def nbytes(self) -> int:
        """Memory that it holds."""
        return self._seconds.nbytes + self._minutes.nbytes

    @property
    def rows(self) -> tuple[int, int]:
        """Seconds and minutes that are kept."""
        return len(self._seconds), len(self._minutes)

    def add(self, t_s: float, row: Array) -> None:
        """Add a second; a minute's sum is added when it is full."""
        with self._lock:
            self._seconds.add(t_s, row)
            self._minute.append(row)
            if len(self._minute) >= _MINUTE:
                self._minutes.add(t_s - _MINUTE / 2, np.concatenate(summed(np.stack(self._minute))))
                self._minute = []

    def read(self, now_s: float, span_s: float, columns: list[int], most: int) -> Series:
        """The last ``span_s`` in at most ``most`` pieces, none shorter than what is kept."""
        with self._lock:
            if span_s <= SECONDS:
                times, values = self._seconds.since(now_s - span_s, columns)
                low, high, row_s = values, values, 1.0
            else:
                times, values, low, high = self._long(now_s - span_s, columns)
                row_s = float(_MINUTE)
        # A piece holds at least a row, and half another one, so that rows a little late leave no gaps.
        pieces = max(1, min(most, int(span_s / (1.5 * row_s))))
        return binned(times, (values, low, high), now_s - span_s, span_s, pieces)

    def _long(self, since_s: float, columns: list[int]) -> tuple[NDArray[np.float64], Array, Array, Array]:
        """Minutes, and the seconds of the one that is not full yet."""
        w = self._width
        times, rows = self._minutes.since(since_s, [c + k * w for k in range(3) for c in columns])
        mean, low, high = np.split(rows, 3, axis=1)
        if self._minute:
            newest, _ = self._seconds.since(since_s, columns)
            parts = summed(np.stack(self._minute)[:, columns])
            times = np.append(times, newest[-len(self._minute) :].mean())
            mean, low, high = (np.vstack([a, b]) for a, b in zip((mean, low, high), parts, strict=True))
        return times, mean, low, high


def summed(rows: Array) -> tuple[Array, Array, Array]:
    """Mean, least and most of the known values of each column, NaN where none is known."""
    known = np.isfinite(rows)
    count = known.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.where(known, rows, 0).sum(axis=0) / count
    mean[count == 0] = np.nan
    return mean.astype(np.float32), np.fmin.reduce(rows, axis=0), np.fmax.reduce(rows, axis=0)


def binned(
    times: NDArray[np.float64], rows: tuple[Array, Array, Array], begin_s: float, span_s: float, pieces: int
) -> Series:
    """Rows of mean, low and high, gathered in pieces of equal length."""
    period = span_s / pieces
    width = rows[0].shape[1]
    out = [np.full((pieces, width), np.nan, np.float32) for _ in range(3)]
    place = np.clip(((times - begin_s) / period).astype(int), 0, pieces - 1)
    for piece in np.unique(place):
        chosen = place == piece
        out[0][piece] = summed(rows[0][chosen])[0]
        out[1][piece] = np.fmin.reduce(rows[1][chosen], axis=0)
        out[2][piece] = np.fmax.reduce(rows[2][chosen], axis=0)
    middles: NDArray[np.float64] = begin_s + period * (np.arange(pieces, dtype=np.float64) + 0.5)
    return Series(middles, period, *out)
