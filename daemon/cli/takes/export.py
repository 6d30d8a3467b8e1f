"""``fringed export``: clouds of a replay or of a take as PLY or PCD files, or as a video of depth maps."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from daemon.cli.options.parts_option import PartsOption, chosen_parts

if TYPE_CHECKING:
    from daemon.apps.export.sources import Clouds
    from pipeline.common.settings import Settings

_VIDEOS = (".mp4", ".avi")


def main(
    source: Annotated[Path, typer.Argument(help="A cloud or snapshot (.npz), a take, or a directory of them.")],
    out: Annotated[
        Path,
        typer.Option(help="Directory for the clouds, of several takes one each; or a video: NAME.mp4, NAME.avi."),
    ],
    kind: Annotated[
        str, typer.Option("--format", help="Kind of cloud files: ply, pcd, npz, or meshes: mesh.ply, glb.")
    ] = "ply",
    parts: PartsOption = None,
    near: Annotated[float | None, typer.Option(min=0, help="Video: depth of the warmest colour, mm.")] = None,
    far: Annotated[float | None, typer.Option(min=0, help="Video: depth of the coldest colour, mm.")] = None,
    rate: Annotated[float, typer.Option(min=0.1, max=240, help="Video: images per second.")] = 10.0,
    calibration: Annotated[Path | None, typer.Option(help="Take: use this calibration instead.")] = None,
    set_: Annotated[list[str] | None, typer.Option("--set", help="Take: change a setting, key=value.")] = None,
) -> None:
    """Convert clouds to PLY, PCD or NPZ files, to meshes, or to a video of depth maps."""
    from daemon.apps.export.cloud_files import KINDS
    from daemon.apps.export.sources import contents
    from daemon.cli.options.set_option import parsed_settings
    from daemon.common.errors import InputError

    if kind not in KINDS:
        raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
    chosen = chosen_parts(parts)
    found, settings = contents(source), parsed_settings(set_ or [])
    for name, reason in found.left_out.items():
        typer.echo(f"left out: {name}: {reason}", err=True)
    if not found.takes and (calibration is not None or set_):
        raise InputError(f"{source} contains clouds; --calibration and --set require a take")
    video = out.suffix.lower() in _VIDEOS
    sources = _Sources(found.clouds, found.takes, calibration, settings, chosen or ())
    if video:
        if chosen is not None:
            raise InputError(f"--parts is for cloud files; {out} is a video of depth maps")
        one = sources.only(source)
        count = _video(one.clouds, one.take, out, near, far, rate)
        typer.echo(f"{count} images in {out}")
        return
    for one in sources.all():
        target = out / one.take_name if one.take_name and sources.several else out
        count = _files(one.clouds(), target, kind, chosen)
        typer.echo(f"{count} {'cloud' if count == 1 else 'clouds'} in {target}")


@dataclass(frozen=True, slots=True)
class _Source:
    """The clouds of a directory, or those of one take."""

    clouds: Callable[[], Clouds]
    take: Path | None = None

    @property
    def take_name(self) -> str:
        return "" if self.take is None else self.take.name.partition(".mcap")[0]


@dataclass(frozen=True, slots=True)
class _Sources:
    """Cloud files and takes of a source."""

    files: list[Path]
    takes: list[Path]
    calibration: Path | None
    settings: Settings
    parts: tuple[str, ...]

    @property
    def several(self) -> bool:
        """Whether each take has a directory of its own."""
        return len(self.takes) + bool(self.files) > 1

    def all(self) -> list[_Source]:
        """The files first, then each take."""
        saved = [_Source(self._saved)] if self.files else []
        return [*saved, *(_Source(partial(self._reconstructed, take), take) for take in self.takes)]

    def only(self, source: Path) -> _Source:
        """The one source of a video; InputError when there are several."""
        if self.several:
            names = ", ".join([*(["clouds"] if self.files else []), *(take.name for take in self.takes)])
            from daemon.common.errors import InputError

            raise InputError(f"{source} contains {names}; a video shows one of them: name a take")
        return self.all()[0]

    def _saved(self) -> Clouds:
        from daemon.apps.export.sources import saved_clouds
        from daemon.cli.options.progress import rendering

        with rendering("Exporting clouds") as progress:
            yield from saved_clouds(self.files, progress, self.parts)

    def _reconstructed(self, take: Path) -> Clouds:
        from daemon.apps.export.sources import reconstructed_clouds
        from daemon.cli.options.progress import rendering

        with rendering(f"Exporting {take.name}") as progress:
            yield from reconstructed_clouds(
                take, progress, calibration=self.calibration, settings=self.settings, parts=self.parts
            )


def _files(clouds: Clouds, out: Path, kind: str, parts: tuple[str, ...] | None) -> int:
    from daemon.apps.export.cloud_files import cloud_bytes, written_clouds
    from daemon.common.files import write_atomically

    written: set[Path] = set()
    for name, cloud in clouds:
        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{name}.{kind}"
        write_atomically(path, cloud_bytes(cloud, kind, parts))
        written.add(path)
    others = [path for path in written_clouds(out) if path.name.partition(".")[2] == kind and path not in written]
    if others:
        typer.echo(f"{out}: {len(others)} clouds there are not of this export: {others[0].name} ...", err=True)
    return len(written)


def _video(
    clouds: Callable[[], Clouds], take: Path | None, out: Path, near: float | None, far: float | None, rate: float
) -> int:
    from daemon.apps.export.depth_video import depth_image, depth_limits, write_video
    from daemon.common.errors import InputError
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
        raise InputError(f"--near {near:g} mm must be smaller than --far {far:g} mm")
    out.parent.mkdir(parents=True, exist_ok=True)
    warm, cold = near, far

    def images() -> Iterator[Any]:
        for _, cloud in clouds():
            yield depth_image(cloud.xyz[..., 2], warm, cold)

    return write_video(out, images(), rate_hz=rate)
