"""A replay in the Rerun viewer or in a file for it; Rerun is imported only when used."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from daemon.common.errors import DaemonError

if TYPE_CHECKING:
    from daemon.apps.replay.runner import Result


class RerunLog:
    """Logs clouds, images and figures like the live viewer.

    Args:
        file: to save to (``.rrd``), None = open the native viewer.

    Raises:
        DaemonError: Rerun is not installed.
    """

    def __init__(self, file: Path | None) -> None:
        try:
            from daemon.apps.viewer import rerun_targets
            from daemon.apps.viewer.rerun_log import Logger

            self._file = file
            self._temporary = None if file is None else file.with_name(f".{file.name}.partial")
            if self._temporary is None:
                self._recording = rerun_targets.to_viewer()
            else:
                self._temporary.parent.mkdir(parents=True, exist_ok=True)
                self._recording = rerun_targets.to_file(self._temporary)
            self._logger = Logger(self._recording, decimate=1)
        except ModuleNotFoundError as error:
            if error.name != "rerun":
                raise
            raise DaemonError("--rerun needs the package rerun-sdk: pip install 'fringed-rig[view]'") from error

    def show(self, result: Result) -> None:
        """Log a cloud, its images and its figures."""
        pair, cloud, run = result.pair, result.cloud, result.runs[-1]
        self._logger.time(seq=pair.sequence, t_ns=pair.t_ns)
        self._logger.cloud(cloud.xyz, cloud.gray, cloud.sigma_mm)
        self._logger.images({"left": _jpeg(pair.left), "right": _jpeg(pair.right)})
        self._logger.figures({"points": float(run.points), "latency_ms": run.total_ms})

    def close(self) -> None:
        """Finish the file, or disconnect from the viewer."""
        self._recording.flush()
        self._recording.disconnect()
        if self._temporary is not None and self._file is not None:
            with self._temporary.open("rb") as written:
                os.fsync(written.fileno())
            self._temporary.replace(self._file)

    def discard(self) -> None:
        """Remove the unfinished file after an error."""
        self._recording.disconnect()
        if self._temporary is not None:
            with suppress(OSError):
                self._temporary.unlink()


def _jpeg(image: NDArray[Any]) -> NDArray[np.uint8]:
    """Encode a raw image as JPEG for display; a mosaic is not demosaiced."""
    eight_bit = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image
    order = eight_bit[..., ::-1] if eight_bit.ndim == 3 else eight_bit
    _, data = cv2.imencode(".jpg", np.ascontiguousarray(order))
    return np.asarray(data, dtype=np.uint8)
