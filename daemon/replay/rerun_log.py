"""Show a replay in the Rerun viewer, or save it for the viewer; Rerun is imported here and only when asked for."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from daemon.errors import DaemonError

if TYPE_CHECKING:
    from daemon.replay.runner import Result

_MEMORY_LIMIT = "2GB"


class RerunLog:
    """Logs clouds, pictures and figures on the timelines ``pair`` and ``exposure``.

    Args:
        name: of the take; file: to save to (``.rrd``), None = open the native viewer.

    Raises:
        DaemonError: when Rerun is not installed.
    """

    def __init__(self, name: str, file: Path | None) -> None:
        try:
            import rerun as rr
        except ModuleNotFoundError as error:
            raise DaemonError("--rerun needs the package rerun-sdk: pip install 'fringed[rig]'") from error
        self._rr, self._file = rr, file
        self._temporary = None if file is None else file.with_name(f".{file.name}.partial")
        self._recording = rr.RecordingStream("fringed-replay", recording_id=name)
        if self._temporary is None:
            self._recording.spawn(memory_limit=_MEMORY_LIMIT)
        else:
            self._temporary.parent.mkdir(parents=True, exist_ok=True)
            self._recording.save(self._temporary)
        # Camera frame: x right, y down, z forward.
        self._recording.log("world", rr.ViewCoordinates.RDF, static=True)

    def show(self, result: Result) -> None:
        """Log the cloud of a pair, its texture and how it went."""
        rr, recording, cloud = self._rr, self._recording, result.cloud
        recording.set_time("pair", sequence=result.pair.sequence)
        recording.set_time("exposure", timestamp=np.datetime64(result.pair.t_ns, "ns"))
        known = np.isfinite(cloud.xyz[..., 2])
        # Packed colours are several times cheaper for Rerun than rows of three.
        gray = cloud.gray[known].astype(np.uint32)
        colors = gray * np.uint32(0x01010100) + np.uint32(0xFF)
        recording.log("world/cloud", rr.Points3D(cloud.xyz[known], colors=colors, radii=0.3))
        recording.log("left/texture", rr.Image(cloud.gray))
        recording.log("figures/points", rr.Scalars(result.runs[-1].points))
        recording.log("figures/sigma_mm", rr.Scalars(float(np.median(cloud.sigma_mm[known])) if known.any() else 0.0))
        recording.log("figures/total_ms", rr.Scalars(result.runs[-1].total_ms))

    def close(self) -> None:
        """Finish the file, or leave the viewer to its user."""
        self._recording.flush()
        self._recording.disconnect()
        if self._temporary is not None and self._file is not None:
            with self._temporary.open("rb") as written:
                os.fsync(written.fileno())
            self._temporary.replace(self._file)

    def abandon(self) -> None:
        """After an error: leave no unfinished file."""
        self._recording.disconnect()
        if self._temporary is not None:
            with suppress(OSError):
                self._temporary.unlink()
