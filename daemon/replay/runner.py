"""Reconstruct the pairs of a take, one after the other, with the time that each took."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.calibration_file import CalibrationFile, read_calibration
from daemon.recording.reader import TakePair, TakeReader
from daemon.sequel import Sequel
from pipeline.cloud import Cloud
from pipeline.errors import PipelineError
from pipeline.reconstruct import Reconstructor
from pipeline.settings import Settings


@dataclass(frozen=True, slots=True)
class Run:
    """One reconstruction of a pair; ``ms`` by stage, ``total_ms`` as seen from outside."""

    sequence: int
    points: int
    total_ms: float
    ms: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The cloud of a pair, and every run that gave it."""

    pair: TakePair
    cloud: Cloud
    runs: list[Run]


@dataclass(slots=True)
class Failure:
    """A pair that could not be reconstructed, and why."""

    sequence: int
    error: str


@dataclass(slots=True)
class Replay:
    """The reconstruction of a take under given settings.

    The clouds depend on nothing but the take, the calibration and the settings: not on ``threads``, not on time, and
    without ``follow`` not on other pairs.

    Args:
        take: the recording, open.
        settings: of the pipeline; threads: 0 = all.
        calibration: file to use instead of the one that is attached.
        follow: begin a pair with the surface of the one before where that is close in time, as a live run does.
    """

    take: TakeReader
    settings: Settings = field(default_factory=Settings)
    threads: int = 0
    calibration: Path | None = None
    follow: bool = False
    failures: list[Failure] = field(default_factory=list)
    _file: CalibrationFile | None = None
    _made: Reconstructor | None = None

    @property
    def calibration_file(self) -> CalibrationFile:
        """The calibration in use."""
        if self._file is None:
            self._file = self.take.calibration() if self.calibration is None else read_calibration(self.calibration)
        return self._file

    def results(self, *, repeat: int = 1, progress: Callable[[int], Any] | None = None) -> Iterator[Result]:
        """The cloud of every pair, in the order of the take.

        A pair that the pipeline refuses is kept in ``failures``, and the next one follows.

        Args:
            repeat: how often each pair is reconstructed; progress: told the number of bytes of the take read so far.

        Raises:
            TakeError, PipelineError: files that do not fit together.
        """
        self.failures.clear()
        sequel = Sequel()
        for pair in self.take.pairs(progress):
            reconstructor = self._reconstructor(pair.encoding)
            runs: list[Run] = []
            follow = self.follow and sequel.follows(pair.sequence, pair.t_ns, 1)
            try:
                for _ in range(repeat):
                    cloud, run = _timed(reconstructor, pair, follow=follow)
                    runs.append(run)
                    follow = self.follow  # a repeated run has the pair itself before it
            except PipelineError as error:
                sequel.forget()
                self.failures.append(Failure(pair.sequence, str(error)))
                continue
            sequel.measured(pair.sequence, pair.t_ns, 1)
            yield Result(pair, cloud, runs)

    def _reconstructor(self, encoding: str) -> Reconstructor:
        """For pictures of this encoding, every kernel compiled."""
        if self._made is None or self._made.encoding != encoding:
            self._made = Reconstructor(
                self.calibration_file.calibration,
                self.take.pattern(),
                self.take.volume(),
                encoding=encoding,
                settings=self.settings,
                clock=time.perf_counter_ns,
                threads=self.threads,
            )
            self._made.warm_up(follow=self.follow)
        return self._made


def _timed(reconstructor: Reconstructor, pair: TakePair, *, follow: bool) -> tuple[Cloud, Run]:
    start_ns = time.perf_counter_ns()
    cloud = reconstructor.reconstruct(pair.left, pair.right, follow=follow)
    total_ms = (time.perf_counter_ns() - start_ns) / 1e6
    stages = {name: round(ms, 3) for name, ms in cloud.ms.items()}
    return cloud, Run(pair.sequence, cloud.points, round(total_ms, 3), stages)
