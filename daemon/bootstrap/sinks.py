"""The sinks of a daemon, made from its configuration; their packages are imported here alone."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from daemon.config.checks import for_others
from daemon.config.rig_config import RigConfig
from daemon.control.rpc.protocol import Method
from daemon.live.items import Sink
from daemon.live.projection.mode_plan import ShownSequence
from daemon.rig.camera_serials import Serials, take_metadata
from daemon.rig.open_rig import Rig
from fringed.control.address import stream_endpoint

if TYPE_CHECKING:
    from daemon.monitoring.health.sink import Health

MEGABYTE = 1_000_000


class StatusSink(Sink, Protocol):
    """The stream: a sink that also carries the status."""

    endpoints: list[str]

    def publish_status(self, status: dict[str, Any]) -> None:
        """Send the status; never blocks."""


def open_publisher(config: RigConfig, rig: Rig, session: str) -> StatusSink:
    """The ZeroMQ publisher, bound to every endpoint."""
    from daemon.live.publishing.publisher import Publisher

    return Publisher(
        local_endpoints(config),
        device=config.device.name,
        session=session,
        calibration=rig.calibration,
        calibration_data=rig.calibration_data,
        identity=rig.identity,
        config=config.model_dump(mode="json"),
        preview_hz=config.stream.preview_hz,
        parts=config.outputs.parts,
        shared_bytes=config.stream.shared_memory_mb * MEGABYTE,
    )


def local_endpoints(config: RigConfig) -> list[str]:
    """Endpoints of the stream that only this machine can reach, at least one; the gate reads the first."""
    local = [endpoint for endpoint in config.stream.endpoints if not for_others(endpoint)]
    return local or [stream_endpoint()]


def open_gate(
    config: RigConfig, base_dir: Path, publisher: StatusSink, control: str, methods: Mapping[str, Method]
) -> Sink | None:
    """The gate between other machines and the stream and ``control``; None when no address is for them."""
    from daemon.keys.key_store import KeyStore
    from daemon.remote_access.gate_messages import GateConfig
    from daemon.remote_access.gate_sink import RemoteGate

    stream = [endpoint for endpoint in config.stream.endpoints if for_others(endpoint)]
    if config.security.keys is None or not (stream or config.control.remote):
        return None
    return RemoteGate(
        GateConfig(
            stream=stream,
            control=config.control.remote,
            source=publisher.endpoints[0],
            target=control,
            roles={name: str(method.role) for name, method in methods.items()},
            connections=config.security.connections,
        ),
        KeyStore(config.path(config.security.keys, base_dir)),
    )


def open_take(
    config: RigConfig,
    rig: Rig,
    session: str,
    path: Path,
    rig_file: Path,
    *,
    serials: Serials,
    shown: ShownSequence | None = None,
) -> Sink:
    """The writer of a take, its first part open; everything that a replay needs is attached.

    Args:
        serials: of the connected cameras; shown: sequence that is shown instead of the rig's pattern.
    """
    from daemon.recording.write.take_writer import TakeWriter

    recording = config.recording
    return TakeWriter(
        path,
        session=session,
        device=config.device.name,
        calibration_data=rig.calibration_data,
        pattern=rig.pattern.as_mapping() if shown is None else shown.pattern,
        volume={"near_mm": rig.volume.near_mm, "far_mm": rig.volume.far_mm},
        rig_data=rig_file.read_bytes(),
        queue=recording.queue,
        max_part_bytes=recording.max_part_mb * MEGABYTE,
        max_part_s=recording.max_part_s,
        min_free_bytes=recording.min_free_mb * MEGABYTE,
        retry_s=recording.retry_s,
        sync=recording.sync,
        endless=recording.endless,
        keep_bytes=recording.keep_mb * MEGABYTE,
        keep_s=recording.keep_s,
        tolerance_ns=round(1000 * config.pairing.tolerance_us),
        extra_metadata=take_metadata(serials) | dict({} if shown is None else shown.metadata),
    )


def open_capture(
    config: RigConfig,
    rig: Rig,
    session: str,
    path: Path,
    pattern: Mapping[str, Any],
    *,
    serials: Serials,
    min_free_bytes: int,
) -> Sink:
    """The writer of a captured sequence: a take whose pattern is the sequence and whose triggers count from 0."""
    from daemon.recording.write.take_writer import TakeWriter

    return TakeWriter(
        path,
        session=session,
        device=config.device.name,
        calibration_data=rig.calibration_data,
        pattern=pattern,
        volume={"near_mm": rig.volume.near_mm, "far_mm": rig.volume.far_mm},
        queue=8,
        max_part_bytes=1 << 40,
        max_part_s=1e9,
        min_free_bytes=min_free_bytes,
        extra_metadata=take_metadata(serials) | {"first_pattern_sequence": "0"},
    )


def open_selfcheck(config: RigConfig, rig: Rig, base_dir: Path) -> Sink:
    """The continuous check of the calibration, running."""
    from daemon.monitoring.calibration_drift.sink import DriftMonitor

    return DriftMonitor(
        config.selfcheck,
        config.path(config.selfcheck.dir, base_dir),
        calibration=rig.calibration,
        pattern=rig.pattern,
        volume=rig.volume,
        identity=rig.identity,
    )


def open_health(config: RigConfig, rig: Rig, base_dir: Path) -> Health:
    """The health monitor, running."""
    from daemon.monitoring.health.sink import Health

    return Health(config, rig, base_dir)
