"""``fringed projector latency``: the delay of the light after the flip, measured with the rig's cameras."""

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
    rig: Annotated[
        Path, typer.Argument(help="rig.yaml with its cameras, triggered as in a measurement, and its projector.")
    ],
    flashes: Annotated[
        int, typer.Option(min=1, max=1000, help="Number of flashes; more of them reduce the uncertainty.")
    ] = 15,
    write: Annotated[
        bool, typer.Option("--write", help="Write it into rig.yaml as projector.options.latency_ms.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Flash black and white, and measure the delay of the light after the flip; no daemon may use the rig."""
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
        latency = measure_latency(devices.cameras, devices.projector, clock=SystemClock(), flashes=flashes)
    finally:
        devices.close()
    typer.echo(json.dumps(asdict(latency)) if as_json else latency_text(latency))
    if write:
        store(rig, latency.ms)
        typer.echo(f"{rig}: {'.'.join(_KEY)} is now {latency.ms:g}", err=as_json)


def latency_text(latency: Latency) -> str:
    """Format a measured latency."""
    periods = f", {latency.frames:.2f} periods of the projector" if latency.frames else ""
    bounds = (
        f"every flash agrees with {latency.earliest_ms:.2f} to {latency.latest_ms:.2f} ms"
        if latency.earliest_ms <= latency.latest_ms
        else f"the flashes vary between {latency.latest_ms:.2f} and {latency.earliest_ms:.2f} ms: it is not constant"
    )
    return (
        f"the light follows the flip after {latency.ms:.2f} ms{periods}; {bounds} "
        f"({latency.flashes} flashes, dark {latency.dark:.0f}, bright {latency.bright:.0f} counts)"
    )


def store(rig: Path, latency_ms: float) -> None:
    """Write the latency into the rig file without other changes."""
    from daemon.common.errors import InputError
    from daemon.common.files import write_atomically
    from daemon.config import parse_rig
    from daemon.config.yaml_edit import with_value

    text = rig.read_text(encoding="utf-8")
    config = parse_rig(text, name=str(rig), base_dir=rig.parent, complete=False)
    if config.projector is not None and "latency_frames" in config.projector.options:
        raise InputError(f"{rig}: projector.options.latency_frames sets the latency already; remove it first")
    write_atomically(rig, with_value(text, _KEY, latency_ms).encode())
