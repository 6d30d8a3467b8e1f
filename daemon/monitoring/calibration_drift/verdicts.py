"""From readings of single pairs to verdicts: robust, with hysteresis, against a reference that was learned once.

Every observable is a sequential test of its own. Its value is the median of the last ten checked pairs (two seconds at
five checks a second): a disturbance must last for more than half of them, and a single bad pair changes nothing. It
has drifted when it differs from the reference by more than the limit in two successive checks; it has recovered when
it is back within 70 % of the limit.

The limit is the configured length or angle, three times the scatter that the scene caused while the reference was
learned, or five standard deviations, whichever is largest. The standard deviations are that of a single pair, because
the differences between parts of a surface are mostly caused by the surface and do not average out while it is at rest,
and that of the median, from the scatter of its pairs. An observable whose standard deviation exceeds the limit itself
is not observable in this scene.

The reference is learned from the first pairs under a calibration and stays, so that slow drift is reported, too.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from daemon.config.rig_config import SelfCheckLimits
from pipeline.monitor import OBSERVABLES
from pipeline.monitor.observe import Reading

WINDOW = 10
"""Checked pairs that a verdict rests on."""
OLDEST_S = 10.0
"""Readings older than this do not count."""
LEARN = 25
"""Readings of a reference; they must also span at least :data:`LEARN_S`."""
LEARN_S = 4.0
SURFACE = "surface_share"
_LEAST = 5
_SIGMAS = 5.0
_SCATTERS = 3.0
_BACK = 0.7
_RUNNING = 2
_MEDIAN = 1.2533  # a median's standard deviation over a mean's
_LOST_SHARE, _SOME_SHARE = 0.1, 0.3


class Verdict(StrEnum):
    """Verdict on an observable."""

    LEARNING = "learning"
    OK = "ok"
    DRIFTED = "drifted"
    UNOBSERVABLE = "not observable"


@dataclass(frozen=True, slots=True)
class Reference:
    """An observable when the calibration was new: its median and the scatter of single pairs."""

    value: float
    scatter: float


@dataclass(frozen=True, slots=True)
class Limit:
    """Largest change against the reference, and largest absolute value (infinite where there is none)."""

    change: float
    absolute: float = math.inf


@dataclass(frozen=True, slots=True)
class Assessment:
    """Present state of an observable; value and sigma are NaN where it is not observable."""

    verdict: Verdict
    value: float = math.nan
    sigma: float = math.nan
    change: float = math.nan
    limit: float = math.nan


def limits_of(config: SelfCheckLimits) -> dict[str, Limit]:
    """Return the limit of every observable."""
    kinds = {
        "column": Limit(config.column_px, config.off_px),
        "slope": Limit(config.column_slope_px, config.off_px),
        "epipolar": Limit(config.epipolar_px, config.off_px),
        "color": Limit(config.color_rad),
        "modulation": Limit(config.modulation),
    }
    return {name: kinds[kind] for name, kind in OBSERVABLES.items()} | {SURFACE: Limit(1.0)}


class _Series:
    """One observable: its last readings, its reference, its verdict."""

    def __init__(self, limit: Limit, reference: Reference | None) -> None:
        self.limit, self.reference = limit, reference
        self.assessment = Assessment(Verdict.LEARNING if reference is None else Verdict.UNOBSERVABLE)
        self._last: deque[tuple[float, float, float]] = deque(maxlen=WINDOW)
        self._learned: list[tuple[float, float]] = []
        self._over = 0

    def feed(self, t_s: float, reading: Reading | None) -> None:
        if reading is not None and math.isfinite(reading.value) and math.isfinite(reading.sigma):
            self._last.append((t_s, reading.value, reading.sigma))
            if self.reference is None:
                self._learn(t_s, reading.value)
        while self._last and self._last[0][0] < t_s - OLDEST_S:
            self._last.popleft()
        self.assessment = self._assess()

    def _learn(self, t_s: float, value: float) -> None:
        self._learned.append((t_s, value))
        if len(self._learned) < LEARN or t_s - self._learned[0][0] < LEARN_S:
            return
        values = np.array([value for _, value in self._learned])
        middle = float(np.median(values))
        if abs(middle) <= self.limit.absolute:
            self.reference = Reference(middle, 1.4826 * float(np.median(np.abs(values - middle))))
        self._learned.clear()

    def _assess(self) -> Assessment:
        drifted = self.assessment.verdict is Verdict.DRIFTED
        limit = self.limit.change
        if self.reference is not None:
            limit = max(limit, _SCATTERS * self.reference.scatter)
        if len(self._last) < _LEAST:
            return self._unobservable(drifted, limit)
        values = np.array([value for _, value, _ in self._last])
        value = float(np.median(values))
        sigma = float(np.median([s for _, _, s in self._last]))
        spread = max(sigma, 1.4826 * float(np.median(np.abs(values - value))))
        of_median = _MEDIAN * spread / math.sqrt(len(values))
        if max(sigma, of_median) > max(self.limit.change, limit / _SCATTERS):
            return self._unobservable(drifted, limit)
        limit = max(limit, _SIGMAS * sigma, _SIGMAS * of_median)
        change = 0.0 if self.reference is None else value - self.reference.value
        size = abs(change)
        over = size > limit or abs(value) > self.limit.absolute
        self._over = self._over + 1 if over else 0
        if drifted:
            verdict = Verdict.DRIFTED if over or size > _BACK * limit else Verdict.OK
        else:
            verdict = Verdict.DRIFTED if self._over >= _RUNNING else Verdict.OK
        if self.reference is None and verdict is Verdict.OK:
            verdict = Verdict.LEARNING
        return Assessment(verdict, value, sigma, change, limit)

    def _unobservable(self, drifted: bool, limit: float) -> Assessment:
        """Return the assessment while there is no value; what has drifted stays so until it is observed again."""
        self._over = 0
        if drifted:
            return self.assessment
        learning = self.reference is None and bool(self._last)
        return Assessment(Verdict.LEARNING if learning else Verdict.UNOBSERVABLE, limit=limit)


class Assessor:
    """Assesses all observables of a rig.

    Args:
        limits: by name of the observable, see :func:`limits_of`.
        references: learned before under the same calibration.
    """

    def __init__(self, limits: Mapping[str, Limit], references: Mapping[str, Reference]) -> None:
        self._series = {name: _Series(limit, references.get(name)) for name, limit in limits.items()}

    def set_limits(self, limits: Mapping[str, Limit]) -> None:
        """Use other limits from the next pair on."""
        for name, limit in limits.items():
            self._series[name].limit = limit

    @property
    def references(self) -> dict[str, Reference]:
        """The references that have been learned."""
        return {name: one.reference for name, one in self._series.items() if one.reference is not None}

    @property
    def assessments(self) -> dict[str, Assessment]:
        """The present state of every observable."""
        return {name: one.assessment for name, one in self._series.items()}

    @property
    def drifted(self) -> dict[str, Assessment]:
        """The observables that have drifted."""
        return {name: now for name, now in self.assessments.items() if now.verdict is Verdict.DRIFTED}

    def feed(self, t_s: float, readings: Mapping[str, Reading], *, surface: Reading | None = None) -> None:
        """Add the readings of a checked pair.

        Args:
            t_s: time of the pair, seconds, rising.
            surface: share of the pixels with fringes that got a point, None where there are hardly any fringes.
        """
        for name, series in self._series.items():
            if name != SURFACE:
                series.feed(t_s, readings.get(name))
        self._feed_surface(t_s, surface)

    def _feed_surface(self, t_s: float, reading: Reading | None) -> None:
        """Assess the share of pixels with a point: it varies with the scene, so that only its collapse counts."""
        series = self._series[SURFACE]
        series.feed(t_s, reading)
        now, reference = series.assessment, series.reference
        if reference is None or math.isnan(now.value):
            return
        lost = reference.value > _SOME_SHARE and now.value < _LOST_SHARE * reference.value
        verdict = Verdict.DRIFTED if lost else Verdict.OK
        limit = _LOST_SHARE * reference.value
        series.assessment = Assessment(verdict, now.value, now.sigma, now.value - reference.value, limit)
