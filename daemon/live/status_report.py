"""The status of a running daemon, put together from all stages of its frame path."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

from daemon.common.processor_share import ProcessorShare
from daemon.common.version import program_version
from daemon.live.acquisition.camera_status import CameraState, CameraStatus
from daemon.live.compatibility import size_problem, timing_warnings
from daemon.live.frame_path import FramePath
from daemon.live.items import SINGLE
from daemon.live.status import State, Status
from drivers.protocols import Clock, ProjectorInfo


def degraded_reasons(path: FramePath) -> tuple[str, ...]:
    """Why the daemon is degraded."""
    reasons = [
        f"camera {side} is gone: {camera.status.problem}"
        for side, camera in path.cameras.items()
        if camera.status.state is CameraState.LOST
    ]
    sizes = (size_problem(side, c.status.size, path.rig.calibration) for side, c in path.cameras.items())
    reasons += filter(None, (*sizes, path.mode_controller.problem()))
    if path.worker.stride > 1:
        reasons.append("the pipeline is overloaded: every second pixel is measured")
    consistency = path.worker.verdicts.last
    if consistency is not None and consistency.verdict == "inconsistent":
        reasons.append(f"the images contradict the calibration: {consistency.reason}")
    problems = {name: sink.status().get("problem") for name, sink in path.router.sinks.items()}
    return (*reasons, *(f"{name}: {problem}" for name, problem in problems.items() if problem))


def _calibration_check(path: FramePath) -> dict[str, Any]:
    """Policy, verdict on the last pair with its readings, and how many clouds were withheld."""
    consistency = path.worker.verdicts.last
    values = {"verdict": "unknown", "reason": "", "readings": {}} if consistency is None else consistency.as_mapping()
    return {"policy": path.config.pipeline.calibration_check, **values, "withheld": path.worker.verdicts.withheld}


def make_status(
    path: FramePath,
    state: tuple[State, tuple[str, ...]],
    projector: ProjectorInfo | None,
    *,
    session: str,
    started_ns: int,
    clock: Clock,
    processor_share: ProcessorShare,
    drops_starting: dict[str, int] | None,
) -> Status:
    """State, counters, rates and latencies of everything.

    Args:
        state: with its reasons; projector: None before it is open; started_ns: monotonic.
        drops_starting: what was dropped before the daemon measured; None while it starts.
    """
    now_ns = clock.monotonic_ns()
    pairer, worker, mode_controller = path.pairer, path.worker, path.mode_controller
    sinks: dict[str, dict[str, Any]] = {name: sink.status() for name, sink in path.router.sinks.items()}
    cameras: dict[str, CameraStatus] = {
        side: replace(camera.status, fates=pairer.outcomes(side)) for side, camera in path.cameras.items()
    }
    return Status(
        state=state[0],
        reasons=state[1],
        warnings=(
            *timing_warnings(projector.refresh_hz if projector else 0.0, cameras),
            *processor_share.warnings(),
            *worker.warnings,
            *filter(None, [path.order_warning if path.mode_controller.mode == SINGLE else ""]),
        ),
        device=path.config.device.name,
        session=session,
        version=program_version(),
        pid=os.getpid(),
        t_ns=clock.realtime_ns(),
        uptime_s=round((now_ns - started_ns) / 1e9, 1),
        calibration=path.rig.identity,
        pairs=pairer.pairs,
        clouds=worker.clouds,
        pair_rate_hz=round(pairer.rate.per_second(now_ns), 2),
        cloud_rate_hz=round(worker.rate.per_second(now_ns), 2),
        points=worker.points,
        valid=round(worker.valid, 4),
        measured_every=worker.stride,
        latency_ms=worker.latency_ms.summary(),
        publish_latency_ms=sinks.get("stream", {}).pop("latency_ms", {}),
        stages_ms=worker.stages_ms,
        garbage=worker.gc_pauses.summary(),
        memory=worker.page_faults.summary(),
        slowest=worker.slowest.summary(),
        processors=processor_share.as_dict(),
        calibration_check=_calibration_check(path),
        drops=path.drops.snapshot(),
        drops_starting=path.drops.snapshot() if drops_starting is None else drops_starting,
        cameras=cameras,
        recorder=sinks.pop("recorder", {"recording": False}),
        selfcheck={"enabled": "selfcheck" in sinks, **sinks.pop("selfcheck", {})},
        health={"enabled": "health" in sinks, **sinks.pop("health", {})},
        mode=mode_controller.mode,
        sequence=mode_controller.status(),
        kernels={"ready": path.kernels.done, "total": path.kernels.total},
        sinks=sinks,
    )
