"""Sources of exported clouds: a directory of a replay, or a take that is reconstructed during the export."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.apps.export.cloud_files import SavedCloud, clouds_in, read_cloud
from daemon.common.errors import DaemonError
from daemon.recording.read.take_reader import TakeReader

if TYPE_CHECKING:
    from pipeline.common.settings import Settings

Clouds = Iterator[tuple[int, SavedCloud]]
Progress = Callable[[int, int], Any]


def is_take(source: Path) -> bool:
    """Whether a source is a take: one of its files, or a directory with parts of one."""
    if source.is_dir():
        return any(source.glob("*.mcap*")) and not any(source.glob("cloud_*.npz"))
    return True


def saved_clouds(directory: Path, progress: Progress) -> Clouds:
    """Yield sequence and cloud of every file in a directory."""
    files = clouds_in(directory)
    for number, (sequence, path) in enumerate(files):
        progress(number, len(files))
        yield sequence, read_cloud(path)
    progress(len(files), len(files))


def reconstructed_clouds(
    path: Path, progress: Progress, *, calibration: Path | None = None, settings: Settings | None = None
) -> Clouds:
    """Yield sequence and cloud of every pair of a take.

    Raises:
        DaemonError: no pair gives a cloud; PipelineError: files that do not match.
    """
    from daemon.apps.replay.runner import Replay
    from pipeline.common.settings import Settings

    with TakeReader(path) as take:
        replay = Replay(take, settings or Settings(), calibration=calibration)
        count = 0
        for result in replay.results(progress=lambda position: progress(position, take.size)):
            count += 1
            yield result.pair.sequence, SavedCloud(result.cloud.xyz, result.cloud.sigma_mm, result.cloud.gray)
        if count == 0:
            reasons = [failure.error for failure in replay.failures[:1]] or take.problems or ["the take is empty"]
            raise DaemonError(f"{path}: no cloud to export: {reasons[0]}")
        progress(take.size, take.size)
