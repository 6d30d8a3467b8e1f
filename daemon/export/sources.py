"""Where exported clouds come from: a directory of a replay, or a take that is reconstructed on the way."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from daemon.calibration_file import read_calibration
from daemon.errors import DaemonError
from daemon.export.cloud_files import SavedCloud, clouds_in, read_cloud
from daemon.recording.reader import TakeReader

Clouds = Iterator[tuple[int, SavedCloud]]
Progress = Callable[[int, int], Any]


def is_take(source: Path) -> bool:
    """Whether a source is a take: one of its files, or a directory that holds nothing but parts of one."""
    if source.is_dir():
        return any(source.glob("*.mcap*")) and not any(source.glob("cloud_*.npz"))
    return True


def saved_clouds(directory: Path, progress: Progress) -> Clouds:
    """Sequence and cloud of every file in a directory."""
    files = clouds_in(directory)
    for done, (sequence, path) in enumerate(files):
        progress(done, len(files))
        yield sequence, read_cloud(path)
    progress(len(files), len(files))


def reconstructed_clouds(
    path: Path, progress: Progress, *, calibration: Path | None = None, overrides: Mapping[str, object] | None = None
) -> Clouds:
    """Sequence and cloud of every pair of a take.

    Raises:
        DaemonError: a take without pairs; PipelineError: pictures or files that do not fit together.
    """
    from pipeline.reconstruct import Reconstructor
    from pipeline.settings import Settings

    settings = Settings().with_overrides(overrides or {})
    with TakeReader(path) as take:
        file = read_calibration(calibration) if calibration is not None else take.calibration()
        made: Reconstructor | None = None
        for pair in take.pairs(lambda done: progress(done, take.size)):
            if made is None or made.encoding != pair.encoding:
                made = Reconstructor(
                    file.calibration, take.pattern(), take.volume(), encoding=pair.encoding, settings=settings
                )
            cloud = made.reconstruct(pair.left, pair.right)
            yield pair.sequence, SavedCloud(cloud.xyz, cloud.sigma_mm, cloud.gray)
        if made is None:
            raise DaemonError(f"{path}: no pairs to export; {'; '.join(take.problems) or 'the take is empty'}")
        progress(take.size, take.size)
