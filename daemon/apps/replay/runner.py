"""Reconstruct the pairs of a take one after the other and measure the time of each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.apps.replay.reconstruct_item import (
    Run,
    check_serials,
    check_size,
    timed,
    warmed_reconstructor,
    with_item_parts,
)
from daemon.apps.replay.take_items import Sets, pairs_of
from daemon.kernels.jobs import measuring_jobs
from daemon.kernels.processes import Progress, compile_kernels
from daemon.live.processing.temporal_prior import TemporalPrior
from daemon.recording.read.take_reader import TakePair, TakeReader
from daemon.rig.calibration_file import CalibrationFile, read_calibration
from pipeline.common.errors import PipelineError
from pipeline.common.settings import Settings
from pipeline.monitor.check.checked_reconstructor import Policy
from pipeline.pattern.sequence import FrameSequence
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.pose import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """The cloud of a pair, or of a set with its newest images, and its runs."""

    pair: TakePair
    cloud: Cloud
    runs: list[Run]


@dataclass(slots=True)
class Failure:
    """A pair or set that could not be reconstructed, with the error."""

    sequence: int
    error: str


@dataclass(slots=True)
class Replay:
    """The reconstruction of a take under given settings.

    The clouds depend only on the take, the calibration and the settings: not on ``threads`` or time, and without
    ``use_prior`` on other pairs only by what the first one gives, column correction and scan.

    Args:
        take: the recording, open.
        settings: of the pipeline; threads: 0 = all.
        calibration: file to use instead of the attached one.
        use_prior: use the previous pair as temporal prior if it is close in time, as in a live run.
        calibration_check: policy for pairs that contradict the calibration, see ``IndependentVerdicts``.
        parts: names of parts that every cloud shall have; ``rgb`` and ``normals`` are computed if they are named.
        compiling: called once a second with the progress while kernels are compiled.
        pose: into the output frame; fuse: average clouds of surfaces at rest, in the order of the take.
    """

    take: TakeReader
    settings: Settings = field(default_factory=Settings)
    threads: int = 0
    calibration: Path | None = None
    use_prior: bool = False
    calibration_check: Policy = "withhold"
    parts: Collection[str] = ()
    compiling: Callable[[Progress], object] | None = None
    pose: Pose | None = None
    fuse: bool = False
    failures: list[Failure] = field(default_factory=list)
    _file: CalibrationFile | None = None
    _cached: Any = None
    _sets: Sets | None = None

    @property
    def sequence(self) -> FrameSequence | None:
        """The sequence of a take of a multi-frame mode, None in the mode single."""
        return self.take.sequence()

    @property
    def incomplete(self) -> int:
        """Incomplete sets of the last iteration."""
        return 0 if self._sets is None else self._sets.incomplete

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras, as far as the last iteration has shown it."""
        return () if self._cached is None else tuple(self._cached.warnings)

    @property
    def calibration_file(self) -> CalibrationFile:
        """The calibration in use."""
        if self._file is None:
            self._file = (
                self.take.calibration()
                if self.calibration is None
                else check_serials(self.take, read_calibration(self.calibration))
            )
        return self._file

    def change(self, settings: Settings) -> None:
        """Use other settings from the next pair on."""
        self.settings, self._cached = settings, None

    def results(self, *, repeat: int = 1, progress: Callable[[int], Any] | None = None) -> Iterator[Result]:
        """Yield the cloud of every pair, or of every complete set of a multi-frame mode, in the order of the take.

        A pair that the pipeline rejects is added to ``failures``.

        Args:
            repeat: reconstructions of each pair; progress: called with the number of bytes read.

        Raises:
            TakeError, PipelineError: files that do not match.
        """
        self.failures.clear()
        sequence, prior = self.sequence, TemporalPrior()
        self._sets = None if sequence is None else Sets(self.take, sequence)
        items = pairs_of(self.take, progress) if self._sets is None else self._sets.items(progress)
        for item in items:
            pair = item.pair
            check_size(item, self.calibration_file.calibration)
            reconstructor = self._reconstructor(pair.encoding, sequence)
            runs: list[Run] = []
            use_prior = self.use_prior and prior.usable(pair.sequence, pair.t_ns, 1)
            try:
                for _ in range(repeat):
                    cloud, run = timed(reconstructor, item, use_prior=use_prior)
                    runs.append(run)
                    use_prior = self.use_prior  # the prior of a repeated run is the pair itself
            except PipelineError as error:
                prior.reset()
                self.failures.append(Failure(pair.sequence, str(error)))
                continue
            prior.measured(pair.sequence, pair.t_ns, 1)
            yield Result(pair, with_item_parts(cloud, reconstructor, item, self.parts), runs)

    def _reconstructor(self, encoding: str, sequence: FrameSequence | None) -> Any:
        """A warmed-up reconstructor for images of an encoding."""
        if self._cached is not None and self._cached.encoding == encoding:
            return self._cached
        compile_kernels(measuring_jobs(encoding, None if sequence is None else sequence.name), self.compiling)
        pattern = self.take.pattern() if sequence is None else sequence
        self._cached = warmed_reconstructor(
            self.calibration_file.calibration, pattern, self.take.volume(), encoding=encoding, settings=self.settings,
            threads=self.threads, use_prior=self.use_prior, policy=self.calibration_check, pose=self.pose,
            fuse=self.fuse,
        )  # fmt: skip
        return self._cached
