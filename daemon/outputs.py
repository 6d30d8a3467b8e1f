"""The sinks of a daemon, made from its configuration; their packages are loaded here and nowhere else."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Protocol

from daemon.config.models import RigConfig
from daemon.rig import Rig
from daemon.sinks import Sink


class StatusSink(Sink, Protocol):
    """The stream: a sink that also carries the status."""

    def publish_status(self, status: dict[str, Any]) -> None:
        """Send the status; never blocks."""


def open_publisher(config: RigConfig, rig: Rig, session: str) -> StatusSink:
    """The ZeroMQ publisher, bound."""
    raise NotImplementedError


def open_take(config: RigConfig, rig: Rig, session: str, path: Path, rig_file: Path) -> Sink:
    """The writer of a take."""
    raise NotImplementedError
