"""The reconstructor of a rig, as its configuration wants it."""

from __future__ import annotations

from collections.abc import Sequence

from daemon.config.models import Pipeline, RigConfig
from daemon.errors import DaemonError
from daemon.rig import Rig
from drivers.protocols import Clock
from pipeline.reconstruct import Reconstructor
from pipeline.settings import Settings


def make_reconstructor(
    config: RigConfig, rig: Rig, settings: Settings, encodings: Sequence[str], clock: Clock
) -> Reconstructor:
    """A reconstructor, not warmed up.

    Args:
        encodings: of both cameras, empty where one is not known yet.
    """
    if len(set(encodings)) != 1 or "" in encodings:
        raise DaemonError(f"the cameras send {sorted(set(encodings))}; both must send the same encoding")
    return Reconstructor(
        rig.calibration,
        rig.pattern,
        rig.volume,
        encoding=encodings[0],
        settings=settings,
        clock=clock.monotonic_ns,
        threads=config.pipeline.threads or len(config.pipeline.cpus),
    )


def warm_up(made: Reconstructor, config: Pipeline) -> None:
    """Compile every kernel that this configuration may need, up to a minute after an update."""
    made.warm_up(every=(1, 2) if config.overload == "half" else (1,), follow=config.temporal_prior)
