"""The reconstructor of a rig, as its configuration needs it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from daemon.common.errors import DaemonError
from daemon.config.rig_config import Pipeline, RigConfig
from daemon.live.items import SINGLE
from daemon.live.processing.cloud_reconstructor import CloudReconstructor
from daemon.live.projection.mode_plan import ModePlan
from daemon.rig.open_rig import Rig
from drivers.protocols import Clock
from pipeline.common.settings import Settings
from pipeline.monitor.check.checked_reconstructor import CheckedReconstructor
from pipeline.monitor.check.set_check import options_for
from pipeline.reconstruct.cloud_filters import cloud_filters
from pipeline.reconstruct.reconstructor import Reconstructor


def make_reconstructor(
    config: RigConfig,
    rig: Rig,
    settings: Settings,
    encodings: Sequence[str],
    clock: Clock,
    *,
    plan: ModePlan | None = None,
) -> CloudReconstructor:
    """Make a reconstructor, not warmed up.

    Args:
        encodings: of both cameras, empty where one is not known yet; plan: of a multi-frame mode.
    """
    if len(set(encodings)) != 1 or "" in encodings:
        raise DaemonError(f"the cameras send {sorted(set(encodings))}; both must send the same encoding")
    options: dict[str, Any] = {
        "encoding": encodings[0],
        "settings": settings,
        "clock": clock.monotonic_ns,
        "threads": config.pipeline.threads or len(config.pipeline.cpus),
    }
    filters = cloud_filters(
        rig.calibration,
        settings,
        mosaic=encodings[0].startswith("bayer_"),
        pose=rig.pose,
        fuse=config.pipeline.temporal == "fuse",
        clock=clock.monotonic_ns,
    )
    if plan is not None:
        return plan.reconstructor(rig, filters=filters, **options_for(config.pipeline.calibration_check), **options)
    single = Reconstructor(rig.calibration, rig.pattern, rig.volume, **options)
    return CheckedReconstructor(single, config.pipeline.calibration_check, filters)


def warm_up(reconstructor: CloudReconstructor, config: Pipeline) -> None:
    """Compile every kernel that this configuration may need, up to a minute after an update."""
    half = config.overload == "half" and reconstructor.mode == SINGLE
    reconstructor.warm_up(strides=(1, 2) if half else (1,), use_prior=config.temporal_prior)
