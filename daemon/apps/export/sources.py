"""Sources of exported clouds: cloud files, or takes that are reconstructed during the export."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from daemon.apps.export.cloud_files import SUFFIX, SavedCloud, cloud_stem, read_cloud, sequence_of
from daemon.common.errors import DaemonError, InputError
from daemon.recording.read.catalog import Listing, scan
from daemon.recording.read.take_reader import TakeReader

if TYPE_CHECKING:
    from pipeline.common.settings import Settings

Clouds = Iterator[tuple[str, SavedCloud]]
"""Names without suffix, and clouds."""

Progress = Callable[[int, int], Any]


@dataclass(frozen=True, slots=True)
class Contents:
    """What a source contains.

    Args:
        clouds: files, in the order of their numbers; takes: the first file of each, oldest first.
        left_out: names of files with the suffix of a take that are none, and why.
    """

    clouds: list[Path]
    takes: list[Path]
    left_out: dict[str, str] = field(default_factory=dict)


def contents(source: Path) -> Contents:
    """What a file or a directory contains.

    Raises:
        InputError: neither clouds nor takes; OSError: the source cannot be read.
    """
    if not source.is_dir():
        source.stat()  # a missing file is an error here
        if source.suffix in (".ply", ".pcd", ".glb"):
            raise InputError(f"{source} is an exported cloud already; give one with its pixel grid (*{SUFFIX})")
        is_cloud = source.suffix == SUFFIX
        return Contents([source] if is_cloud else [], [] if is_cloud else [source])
    files = [path for path in source.iterdir() if path.suffix == SUFFIX and not path.name.startswith(".")]
    listing = scan(source) if any(source.glob("*.mcap*")) else Listing()
    found = Contents(
        sorted(files, key=lambda path: (sequence_of(path), path.name)),
        [source / take.files[0] for take in listing.takes],
        listing.other_files,
    )
    if not found.clouds and not found.takes:
        raise InputError(
            f"{source}: there are no clouds (*{SUFFIX}) and no takes (*.mcap) in it; "
            "`fringed replay TAKE.mcap --out DIR` writes clouds"
        )
    return found


def saved_clouds(files: list[Path], progress: Progress, parts: Collection[str] = ()) -> Clouds:
    """Yield name and cloud of every file, with these parts; InputError for one without its colour."""
    for number, path in enumerate(files):
        progress(number, len(files))
        yield path.stem, read_cloud(path).completed(parts, path)
    progress(len(files), len(files))


def reconstructed_clouds(
    path: Path,
    progress: Progress,
    *,
    calibration: Path | None = None,
    settings: Settings | None = None,
    parts: Collection[str] = (),
) -> Clouds:
    """Yield name and cloud of every pair of a take, with these parts.

    Raises:
        DaemonError: no pair gives a cloud; PipelineError: files that do not match.
    """
    from daemon.apps.replay.runner import Replay
    from pipeline.common.settings import Settings

    with TakeReader(path) as take:
        replay = Replay(take, settings or Settings(), calibration=calibration, parts=parts)
        count = 0
        for result in replay.results(progress=lambda position: progress(position, take.size)):
            count += 1
            cloud = SavedCloud.of(result.cloud)
            yield cloud_stem(result.pair.sequence), cloud.completed(parts, path)
        if count == 0:
            reasons = [failure.error for failure in replay.failures[:1]] or take.problems or ["the take is empty"]
            raise DaemonError(f"{path}: no cloud to export: {reasons[0]}")
        progress(take.size, take.size)
