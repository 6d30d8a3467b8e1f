"""``fringed export``: clouds of a replay or of a take as PLY or PCD files, or as a video of depth maps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from daemon.apps.export.sources import Clouds

_VIDEOS = (".mp4", ".avi")


def main(
    source: Annotated[Path, typer.Argument(help="Directory of a replay (cloud_NNNNNN.npz), or a take.")],
    out: Annotated[Path, typer.Option(help="Directory for the clouds, or a video: NAME.mp4, NAME.avi.")],
    kind: Annotated[str, typer.Option("--format", help="Kind of cloud files: ply, pcd or npz.")] = "ply",
    near: Annotated[float | None, typer.Option(min=0, help="Video: depth of the warmest colour, mm.")] = None,
    far: Annotated[float | None, typer.Option(min=0, help="Video: depth of the coldest colour, mm.")] = None,
    rate: Annotated[float, typer.Option(min=0.1, max=240, help="Video: images per second.")] = 10.0,
    calibration: Annotated[Path | None, typer.Option(help="Take: use this calibration instead.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="Take: change a setting, key=value.")] = None,
) -> None:
    """Convert clouds to PLY or PCD files, or to a video of depth maps."""
    from daemon.apps.export.cloud_files import KINDS
    from daemon.apps.export.sources import is_take, reconstructed_clouds, saved_clouds
    from daemon.cli.options.progress import rendering
    from daemon.cli.options.set_option import parsed_settings
    from daemon.common.errors import DaemonError

    if kind not in KINDS:
        raise DaemonError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
    from_take, settings = is_take(source), parsed_settings(set_ or [])
    if not from_take and (calibration is not None or set_):
        raise DaemonError(f"{source} contains clouds; --calibration and --set require a take")
    with rendering(f"Exporting {source.name}") as progress:

        def clouds() -> Clouds:
            if not from_take:
                return saved_clouds(source, progress)
            return reconstructed_clouds(source, progress, calibration=calibration, settings=settings)

        if out.suffix.lower() in _VIDEOS:
            count = _video(clouds, source if from_take else None, out, near, far, rate)
        else:
            count = _files(clouds(), out, kind)
    typer.echo(f"{count} {'images' if out.suffix.lower() in _VIDEOS else 'clouds'} in {out}")


def _files(clouds: Clouds, out: Path, kind: str) -> int:
    from daemon.apps.export.cloud_files import cloud_bytes, cloud_name
    from daemon.common.files import write_atomically

    out.mkdir(parents=True, exist_ok=True)
    count = 0
    for sequence, cloud in clouds:
        write_atomically(out / cloud_name(sequence, kind), cloud_bytes(cloud, kind))
        count += 1
    return count


def _video(
    clouds: Callable[[], Clouds], take: Path | None, out: Path, near: float | None, far: float | None, rate: float
) -> int:
    from daemon.apps.export.depth_video import depth_image, depth_limits, write_video
    from daemon.common.errors import DaemonError
    from daemon.recording.read.take_reader import TakeReader

    if near is None or far is None:
        if take is None:
            limits = depth_limits(cloud.xyz[..., 2] for _, cloud in clouds())
        else:  # a second reconstruction only for the limits would take too long
            with TakeReader(take) as reader:
                volume = reader.volume()
            limits = volume.near_mm, volume.far_mm
        near, far = (limits[0] if near is None else near), (limits[1] if far is None else far)
    if near >= far:
        raise DaemonError(f"--near {near:g} mm must be smaller than --far {far:g} mm")
    out.parent.mkdir(parents=True, exist_ok=True)
    warm, cold = near, far

    def images() -> Iterator[Any]:
        for _, cloud in clouds():
            yield depth_image(cloud.xyz[..., 2], warm, cold)

    return write_video(out, images(), rate_hz=rate)
