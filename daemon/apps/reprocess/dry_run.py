"""What a run would do: pairs, bytes, and a time estimated from one pair that is reconstructed here."""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import dataclass, field

from daemon.apps.replay.reconstruct_item import timed, warmed_reconstructor
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location
from daemon.apps.reprocess.plan.recordings import Recording
from daemon.apps.reprocess.work.chunk_work import calibration_of
from daemon.apps.reprocess.work.frame_loader import FrameLoader
from daemon.apps.reprocess.work.take_work import Planned, plan_recording
from daemon.common.errors import DaemonError
from daemon.recording.read.take_reader import TakeReader
from pipeline.common.errors import PipelineError


@dataclass(slots=True)
class Estimate:
    """Size of a run.

    Args:
        items: pairs or sets; left: those without a result so far; bytes: of all recordings.
        item_s: seconds that one thread takes for one, 0 if none could be reconstructed; seconds: of the whole run.
    """

    items: int = 0
    left: int = 0
    bytes: int = 0
    item_s: float = 0.0
    seconds: float = 0.0
    problems: list[str] = field(default_factory=list)


def estimate(job: Job, recordings: Iterable[Recording], out: str, workers: int) -> Estimate:
    """Plan every recording, and reconstruct the first pair of the first one that allows it, by one thread."""
    found = Estimate()
    for recording in recordings:
        planned = plan_recording(job, recording.url, str(location(out) / recording.name))
        if planned.plan is None:
            found.problems.append(planned.error)
            continue
        found.items += planned.plan.items
        found.bytes += planned.plan.bytes
        found.problems += planned.plan.problems
        chunks = enumerate(planned.plan.chunks)
        found.left += sum(len(chunk.items) for number, chunk in chunks if number not in planned.done)
        if not found.item_s and planned.plan.items:
            found.item_s = _seconds(job, recording.url, planned)
    found.seconds = found.left * found.item_s / workers
    return found


def _seconds(job: Job, url: str, planned: Planned) -> float:
    """Time of the first item, reconstructed twice: the first time also measures the column correction."""
    assert planned.plan is not None  # noqa: S101 - checked by the caller
    try:
        with TakeReader(location(url)) as take:
            calibration = calibration_of(take, job)
            item = FrameLoader(take).item(planned.plan.chunks[0].items[0])
            reconstructor = warmed_reconstructor(
                calibration.calibration, take.sequence() or take.pattern(), take.volume(),
                encoding=item.pair.encoding, settings=job.settings, threads=1, policy=job.calibration_check,
            )  # fmt: skip
            timed(reconstructor, item, use_prior=False)
            start_s = time.perf_counter()
            timed(reconstructor, item, use_prior=False)
            return time.perf_counter() - start_s
    except (DaemonError, PipelineError, OSError):
        return 0.0
