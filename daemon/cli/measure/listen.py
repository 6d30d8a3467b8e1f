"""``fringed listen``: rate, points, latency and losses of a stream, once a second."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from statistics import median
from typing import Annotated

import numpy as np
import typer

from daemon.cli.options.key_options import KeyOption, ServerKeyOption, chosen_keys
from daemon.cli.options.parts_option import PartsOption, chosen_parts
from daemon.common.errors import InputError
from fringed.errors import SilenceError
from fringed.parts import BASIC, PARTS, topic_of
from fringed.stream.received_cloud import ReceivedCloud
from fringed.stream.subscription import DEFAULT_ENDPOINT, Subscription, subscribe

_WAIT_S = 0.25


def main(
    endpoint: Annotated[str, typer.Argument(help="Of the stream: tcp://HOST:PORT or ipc://PATH.")] = DEFAULT_ENDPOINT,
    topic: Annotated[str, typer.Option(help="cloud/full or cloud/depth.")] = "cloud/full",
    every: Annotated[bool, typer.Option("--every", help="Receive every cloud, not only the newest.")] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per line.")] = False,
    save: Annotated[Path | None, typer.Option(help="Write each cloud into this directory.")] = None,
    kind: Annotated[
        str, typer.Option("--format", help="With --save: ply, pcd, npz, or meshes: mesh.ply, glb.")
    ] = "ply",
    parts: PartsOption = None,
    count: Annotated[int | None, typer.Option(min=1, help="Stop after this number of clouds.")] = None,
    seconds: Annotated[float | None, typer.Option(min=0.1, help="Stop after this time.")] = None,
    key: KeyOption = None,
    server_key: ServerKeyOption = None,
) -> None:
    """Print rate, points, latency and losses of a stream once a second, until Ctrl-C."""
    chosen = chosen_parts(parts)
    saving = None if save is None else Saving(save, kind, chosen)
    if chosen is not None:
        if topic != "cloud/full":
            raise InputError(f"--parts chooses the topic itself; remove --topic {topic}")
        # Reports count points, and an npz needs the basic parts.
        wanted = {*chosen, *(BASIC if kind == "npz" else ())} if save is not None else chosen
        topic = topic_of([name for name in PARTS if name in wanted])
    elif save is not None and kind == "npz" and topic != "cloud/full":
        raise InputError(f"an npz needs gray and sigma, which {topic} does not carry; remove --topic")
    keys = chosen_keys(key, server_key)
    with subscribe(endpoint, topic=topic, latest=not every, timeout_s=_WAIT_S, keys=keys) as stream:
        for report in reports(stream, save=saving, count=count, seconds=seconds):
            typer.echo(json.dumps(asdict(report)) if as_json else line(report))
        if count is not None and stream.received < count:
            typer.echo(
                f"{stream.received} of {count} clouds arrived from {endpoint}; check with `fringed status` that a "
                "daemon runs",
                err=True,
            )
            raise typer.Exit(1)


@dataclass(slots=True)
class Report:
    """One second of a stream; latencies from the start of exposure, by this machine's clock, ms (median)."""

    clouds: int = 0
    clouds_per_second: float = 0.0
    points: int = 0
    valid: float = 0.0
    latency_ms: float | None = None
    daemon_latency_ms: float | None = None
    lost: int = 0
    skipped: int = 0
    session: str = ""
    device: str = ""
    seq: int | None = None


@dataclass(slots=True)
class _Second:
    """The clouds since the last report."""

    start_s: float
    latencies_ms: list[float] = field(default_factory=list)
    last: ReceivedCloud | None = None

    def add(self, cloud: ReceivedCloud) -> None:
        self.latencies_ms.append((time.time_ns() - cloud.header.t_ns) / 1e6)
        self.last = cloud

    def report(self, stream: Subscription, now_s: float) -> Report:
        out = Report(clouds=stream.received, lost=stream.lost, skipped=stream.skipped)
        if self.last is not None:
            header, points = self.last.header, int(self.last.valid.sum())
            out.clouds_per_second = round(len(self.latencies_ms) / max(now_s - self.start_s, 1e-3), 2)
            out.points, out.valid = points, round(points / self.last.valid.size, 4)
            out.latency_ms, out.daemon_latency_ms = round(median(self.latencies_ms), 1), header.stats.get("latency_ms")
            out.session, out.device, out.seq = header.session, header.device, header.seq
        return out


def reports(
    stream: Subscription,
    *,
    save: Callable[[ReceivedCloud], None] | None = None,
    count: int | None = None,
    seconds: float | None = None,
    now_s: Callable[[], float] = time.monotonic,
) -> Iterator[Report]:
    """Yield a report each second, and a last one at the end."""
    start_s = now_s()
    second = _Second(start_s)
    while True:
        try:
            cloud = next(stream)
        except SilenceError:
            pass
        else:
            second.add(cloud)
            if save is not None:
                save(cloud)
        finished = _reached(stream.received, count) or _reached(now_s() - start_s, seconds)
        if finished or now_s() - second.start_s >= 1.0:
            yield second.report(stream, now_s())
            second = _Second(now_s())
        if finished:
            return


def _reached(value: float, limit: float | None) -> bool:
    return limit is not None and value >= limit


def line(report: Report) -> str:
    """Format a report as one line."""
    if report.latency_ms is None:
        return f"no cloud; {report.clouds} in total, lost {report.lost}"
    return (
        f"{report.device}: {report.clouds_per_second:.1f} clouds/s, {report.points} points "
        f"({100 * report.valid:.0f} %), latency {report.latency_ms:.0f} ms, "
        f"lost {report.lost}, skipped {report.skipped}"
    )


class Saving:
    """Writes each cloud into a directory.

    Args:
        directory: made when it is missing; kind, parts: as of :func:`daemon.apps.export.cloud_files.cloud_bytes`.

    Raises:
        InputError: an unknown kind, or the directory has clouds that this call did not write.
    """

    def __init__(self, directory: Path, kind: str = "ply", parts: tuple[str, ...] | None = None) -> None:
        from daemon.apps.export.cloud_files import KINDS, written_clouds

        if kind not in KINDS:
            raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
        directory.mkdir(parents=True, exist_ok=True)
        earlier = written_clouds(directory)
        if earlier:
            raise InputError(
                f"--save {directory} has {len(earlier)} clouds already ({earlier[0].name}); choose another directory, "
                "or remove them"
            )
        self._directory, self._kind, self._parts = directory, kind, parts

    def __call__(self, cloud: ReceivedCloud) -> None:
        """Write one cloud; other programs never read an incomplete file."""
        from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name
        from daemon.common.files import write_atomically

        grid = cloud.xyz.shape[:2]
        gray = np.zeros(grid, np.uint8) if cloud.gray is None else cloud.gray
        sigma = np.full(grid, np.nan, np.float32) if cloud.sigma is None else cloud.sigma
        saved = SavedCloud(cloud.xyz, sigma, gray, cloud.rgb, cloud.normals, cloud.interpolated)
        parts = ("xyz",) if self._parts is None and cloud.gray is None else self._parts
        write_atomically(
            self._directory / cloud_name(cloud.header.seq, self._kind), cloud_bytes(saved, self._kind, parts)
        )
