"""``fringed projector latency``: how late the light is, seen by the rig's own cameras; the daemon must not run."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from daemon.live.projection.latency_measurement import Latency

_KEY = ("projector", "options", "latency_ms")


def main(
    rig: Annotated[Path, typer.Argument(help="rig.yaml: its cameras, triggered as in a measurement, and projector.")],
    flashes: Annotated[int, typer.Option(min=1, max=1000, help="More of them narrow it down.")] = 15,
    write: Annotated[
        bool, typer.Option("--write", help="Put it into rig.yaml as projector.options.latency_ms.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="For programs.")] = False,
) -> None:
    """Flash black and white, and tell how long after the flip the cameras see it."""
    from daemon.common.clock import SystemClock
    from daemon.config import load_rig
    from daemon.live.projection.latency_measurement import measure_latency
    from daemon.rig.open_rig import OptionsError, open_devices

    config = load_rig(rig, complete=False)
    try:
        devices = open_devices(config, rig.resolve().parent)
    except OptionsError as error:
        raise error.located(rig) from error

    try:
        found = measure_latency(devices.cameras, devices.projector, clock=SystemClock(), flashes=flashes)
    finally:
        devices.close()
    typer.echo(json.dumps(asdict(found)) if as_json else told(found))
    if write:
        store(rig, found.ms)
        typer.echo(f"{rig}: {'.'.join(_KEY)} is now {found.ms:g}", err=as_json)


def told(found: Latency) -> str:
    """What was found, in two sentences."""
    periods = f", {found.frames:.2f} periods of the projector" if found.frames else ""
    bounds = (
        f"every flash agrees with {found.earliest_ms:.2f} to {found.latest_ms:.2f} ms"
        if found.earliest_ms <= found.latest_ms
        else f"the flashes scatter over {found.latest_ms:.2f} to {found.earliest_ms:.2f} ms: it is not constant"
    )
    return (
        f"the light comes {found.ms:.2f} ms after the flip{periods}; {bounds} "
        f"({found.flashes} flashes, dark {found.dark:.0f}, bright {found.bright:.0f} counts)"
    )


def store(rig: Path, latency_ms: float) -> None:
    """Write it into the rig file, whose other bytes stay."""
    from daemon.common.errors import DaemonError
    from daemon.common.files import write_atomically
    from daemon.config import parse_rig
    from daemon.config.yaml_edit import with_value

    text = rig.read_text(encoding="utf-8")
    config = parse_rig(text, name=str(rig), base_dir=rig.parent, complete=False)
    if config.projector is not None and "latency_frames" in config.projector.options:
        raise DaemonError(f"{rig}: projector.options.latency_frames tells the latency already; take it out first")
    write_atomically(rig, with_value(text, _KEY, latency_ms).encode())
