"""Takes for the tests, and the results of plain replays of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name
from daemon.apps.replay.runner import Replay
from daemon.apps.reprocess.engine.tasks import Completed, InlineEngine
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.plan.recordings import recordings_of
from daemon.apps.reprocess.report.totals import Totals
from daemon.apps.reprocess.run import Run
from daemon.apps.reprocess.work import chunk_work
from daemon.recording.read.take_reader import TakeReader
from daemon.rig.calibration_file import read_calibration
from tests.daemon.recording import small_take


def write(path: Path, images: list[small_take.Images], count: int, **options: Any) -> Path:
    """A take of ``count`` pairs of the scenes in turn."""
    path.parent.mkdir(parents=True, exist_ok=True)
    return small_take.write(path, [images[n % len(images)] for n in range(count)], **options)


def replayed(
    take: Path, kind: str = "npz", parts: tuple[str, ...] = (), **options: Any
) -> tuple[dict[str, bytes], list[dict[str, Any]]]:
    """Clouds as files by name, and the verdict of every pair, of a replay."""
    files, verdicts = {}, []
    with TakeReader(take) as reader:
        for result in Replay(reader, parts=parts, **options).results():
            cloud = SavedCloud.of(result.cloud).completed(parts, take)
            files[cloud_name(result.pair.sequence, kind)] = cloud_bytes(cloud, kind, parts or None)
            verdicts.append({"sequence": result.pair.sequence, "consistency": result.runs[-1].consistency})
    return files, verdicts


def files_of(folder: Path) -> dict[str, bytes]:
    """Clouds of a recording in a destination by name."""
    return {path.name: path.read_bytes() for path in folder.glob("cloud_*")}


class FreshProcesses(InlineEngine):
    """Every task meets the state of a process that has just started."""

    def wait(self, timeout_s: float) -> list[Completed]:
        chunk_work._reconstructors.clear()
        return super().wait(timeout_s)


def reprocess(sources: list[Path], out: Path, *, retry_failed: bool = False, engine: Any = None, **job: Any) -> Totals:
    """A run in this process."""
    if isinstance(job.get("calibration"), Path):
        job["calibration"] = read_calibration(job["calibration"]).data
    run = Run(Job(**job), out, engine or FreshProcesses(), retry_failed=retry_failed)
    return run.run(recordings_of(map(str, sources)))
