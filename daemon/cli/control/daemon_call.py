"""Options and the call that commands for a running daemon share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from fringed.keys import Keys

Endpoint = Annotated[str | None, typer.Option(help="Control endpoint of the daemon.")]
RigFile = Annotated[Path | None, typer.Option(help="Take the endpoint from this rig.yaml.")]
Timeout = Annotated[float, typer.Option(min=0.1, help="Seconds to wait for the answer.")]

SLOW_S = 30.0
"""Time-out of calls that wait for the pipeline or for a disk."""


def call_daemon(
    method: str,
    endpoint: str | None,
    rig: Path | None,
    timeout_s: float = SLOW_S,
    keys: Keys | None = None,
    /,
    **params: Any,
) -> Any:
    """Call a method of the daemon and return its answer; ControlError with the daemon's message."""
    from fringed.control.client import ControlClient

    with ControlClient(control_endpoint(endpoint, rig), timeout_s=timeout_s, keys=keys) as client:
        return client.call(method, **params)


def control_endpoint(endpoint: str | None, rig: Path | None) -> str:
    """The given endpoint, that of a rig file, or the default."""
    if endpoint is not None:
        return endpoint
    if rig is not None:
        from daemon.config import load_rig

        return load_rig(rig).control.endpoint
    from fringed.control.address import found_control_endpoint

    return found_control_endpoint()
