"""Settings compared on a sample of pairs: every combination of their values, with coverage, rejected share and time."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from daemon.apps.replay.reconstruct_item import check_size, timed
from daemon.apps.reprocess.carried_state import CarriedState, capture
from daemon.apps.reprocess.engine.tasks import Engine
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location
from daemon.apps.reprocess.plan.chunk_plan import plan_take
from daemon.apps.reprocess.plan.recordings import Recording
from daemon.apps.reprocess.report.totals import Sums
from daemon.apps.reprocess.work.chunk_work import ChunkOutcome, calibration_of, reconstructor_for, shares
from daemon.apps.reprocess.work.frame_loader import DamagedFramesError, FrameLoader
from daemon.common.errors import DaemonError
from daemon.recording.read.take_reader import TakeReader
from pipeline.common.errors import PipelineError

MAX_COMBINATIONS = 1000
_POLL_S = 1.0


@dataclass(slots=True)
class GridRow:
    """One combination: its changes of the settings, the sums over the sample, and what went wrong."""

    changes: dict[str, Any]
    sums: Sums = field(default_factory=Sums)
    failures: list[str] = field(default_factory=list)

    def as_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"settings": self.changes, **self.sums.means(), "failures": self.failures}


def combinations(values: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Every combination of the values, the last setting changing fastest.

    Raises:
        DaemonError: there are more than 1000.
    """
    made = [dict(zip(values, row, strict=True)) for row in itertools.product(*values.values())]
    if len(made) > MAX_COMBINATIONS:
        raise DaemonError(f"--set gives {len(made)} combinations, limit {MAX_COMBINATIONS}; give fewer values")
    return made


def search(
    job: Job, recordings: Sequence[Recording], grid: Sequence[Mapping[str, Any]], sample: int, engine: Engine
) -> list[GridRow]:
    """Reconstruct a sample of pairs with every combination.

    Args:
        job: its settings are those that a combination changes; pairs that contradict the calibration keep their
            points, or the coverage would depend on the verdict.
        sample: number of pairs, spread evenly over the recordings.

    Raises:
        PipelineError: a combination with an unknown setting or a value out of bounds, before any work.
    """
    rows = [GridRow(dict(changes)) for changes in grid]
    jobs = [
        dataclasses.replace(job, settings=job.settings.with_overrides(row.changes), calibration_check="warn", kind="")
        for row in rows
    ]
    left = 0
    for recording, pairs in shared_out(recordings, sample):
        for number, one in enumerate(jobs):  # all combinations of a recording follow each other: its file is cached
            engine.submit((number, recording.name), measure_sample, one, recording.url, pairs)
            left += 1
    while left:
        for ended in engine.wait(_POLL_S):
            left -= 1
            number, name = ended.label
            outcome: ChunkOutcome = ended.value or ChunkOutcome(error=ended.error)
            rows[number].sums.add(Sums.of(outcome))
            if outcome.error:
                rows[number].failures.append(f"{name}: {outcome.error}")
    return rows


def shared_out(recordings: Sequence[Recording], sample: int) -> Iterator[tuple[Recording, int]]:
    """Yield recordings, spread evenly over all, and the number of pairs of each."""
    count = min(len(recordings), sample)
    for n in range(count):
        yield recordings[n * len(recordings) // count], sample // count + (n < sample % count)


def measure_sample(job: Job, url: str, pairs: int) -> ChunkOutcome:
    """Reconstruct some pairs of a recording, evenly spread, after its first pair, which gives the column correction."""
    out = ChunkOutcome()
    try:
        plan = plan_take(location(url), chunk_pairs=job.chunk_pairs)
        items = [item for chunk in plan.chunks for item in chunk.items]
        chosen = {n * len(items) // pairs for n in range(pairs)}
        with TakeReader(location(url)) as take:
            loader, calibration, state = FrameLoader(take), calibration_of(take, job), CarriedState()
            for number, planned in enumerate(items):
                if number and number not in chosen:
                    continue
                try:
                    item = loader.item(planned)
                    check_size(item, calibration.calibration)
                    reconstructor, state = reconstructor_for(take, job, calibration, item.pair.encoding, state)
                    for _ in range(1 + (number == 0)):  # the time of the first pair is that of a pair like others
                        cloud, run = timed(reconstructor, item, use_prior=False)
                except (DamagedFramesError, PipelineError):
                    out.failed += number in chosen
                    continue
                if number in chosen:
                    share = shares(cloud, run.points)
                    out.points.append(run.points)
                    out.coverage.append(share["coverage"])
                    out.rejected.append(share["rejected"])
                    out.total_ms.append(run.total_ms)
                    out.verdicts.append((run.consistency or {}).get("verdict", ""))
                state = capture(reconstructor)
    except (DaemonError, PipelineError, OSError) as error:
        out.error = str(error)
    return out
