"""Another mode in a running daemon: all of it changes between two clouds, or nothing does."""

from __future__ import annotations

from daemon.errors import DaemonError
from daemon.service import Service

CHANGE_S = 180.0
"""The kernels of another mode may have to be compiled."""


def change_mode(service: Service, mode: str) -> None:
    """Measure in another mode from now on.

    Raises:
        DaemonError, DriverError, PipelineError: why not; it goes on in the mode that it was in.
    """
    if not service.ready:
        raise DaemonError("the daemon is still starting; try again when it is running")
    if service.capturing:
        raise DaemonError("the projector is showing pictures for a capture; end it with calibrate.cancel")
    recorder = service.sinks.get("recorder")
    if recorder is not None and recorder.status().get("recording"):
        raise DaemonError("a take is being written, and a take is of one mode; stop it first")
    service.sequencing.change(mode, lambda: service.take_over(CHANGE_S))
