"""Capture through a running daemon, with its control methods ``calibrate.*``."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from daemon.apps.calibration.guided.capture import CapturedImages, Progress, no_progress
from daemon.common.errors import ControlError, DaemonError
from daemon.control.rpc.client import ControlClient
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from daemon.recording.read.take_reader import TakeReader
from daemon.rig.camera_serials import serials_of_take
from pipeline.pattern.sequence import FrameSequence

HOLD_S = 20.0
"""Time for which the daemon keeps projecting between two captures; after longer pauses it starts again."""
_POLL_S = 0.03
_LONGEST_SILENCE_S = 120.0


class CaptureFromDaemon:
    """Captures through the daemon at a control endpoint, and reads the files that it writes on the same machine.

    Args:
        client: connected; closed by :meth:`close`.

    Raises:
        ControlError: no daemon answers. DaemonError: the daemon is still starting.
    """

    def __init__(self, client: ControlClient, *, cancelled: Callable[[], bool] = lambda: False) -> None:
        self._client, self._cancelled = client, cancelled
        status = client.call("calibrate.status")
        size, self._has_hand = status.get("projector"), bool(status.get("hand"))
        self._pose: Any = None
        if size is None:
            raise DaemonError(f"the daemon at {client.endpoint} is still starting; try again when it is running")
        self._size = int(size[0]), int(size[1])

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the projector, pixels."""
        return self._size

    def capture(self, sequence: FrameSequence, *, progress: Progress = no_progress) -> CapturedImages:
        """Capture a pair for each frame, see :class:`daemon.apps.calibration.guided.capture.ImageCapture`."""
        frames = [frame.as_mapping() for frame in sequence.frames]
        job = self._client.call("calibrate.capture", frames=frames, name=sequence.name, hold_s=HOLD_S)["job"]
        status = self._wait(job, progress)
        if status["outcome"] == "cancelled":
            raise CaptureCancelledError("the capture was cancelled")
        if status["outcome"] != "done":
            raise DaemonError(str(status["problem"]))
        return _read(Path(status["file"]), len(sequence))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, whole sentences."""
        return ("the daemon uses its old calibration until it is restarted",)

    @property
    def has_hand(self) -> bool:
        """Whether a simulated hand, not a person, holds the board."""
        return self._has_hand

    def next_pose(self) -> bool:
        """Move the board to the simulated hand's next pose; False after the last pose, or without a simulated hand."""
        if not self._has_hand:
            return False
        before, self._pose = self._pose, self._client.call("calibrate.next_pose")["pose"]
        return self._pose is None or self._pose != before

    def close(self) -> None:
        """End the captures; the daemon measures again."""
        try:
            self._client.call("calibrate.cancel")
        except ControlError:
            pass  # the daemon has ended
        finally:
            self._client.close()

    def _wait(self, job: int, progress: Progress) -> dict[str, Any]:
        completed, since_s = -1, time.monotonic()
        while True:
            status: dict[str, Any] = self._client.call("calibrate.status")
            if status["job"] != job:
                raise DaemonError(f"another client captures through {self._client.endpoint} (job {status['job']})")
            if status["done"] != completed:
                completed, since_s = status["done"], time.monotonic()
                progress(completed, status["of"])
            if status["outcome"]:
                return status
            if self._cancelled() or time.monotonic() - since_s > _LONGEST_SILENCE_S:
                self._client.call("calibrate.cancel")
                raise CaptureCancelledError("the capture was cancelled")
            time.sleep(_POLL_S)


def _read(path: Path, frames: int) -> CapturedImages:
    with TakeReader(path) as take:
        pairs = sorted(take.pairs(), key=lambda pair: pair.sequence)
        numbers = [pair.sequence for pair in pairs]
        if numbers != list(range(frames)):
            first = numbers[0] if numbers else 0
            raise DaemonError(f"{path}: it contains {len(pairs)} of {frames} images, numbered from {first}")
        serials = serials_of_take(take.metadata)
    return CapturedImages(pairs[0].encoding, tuple((pair.left, pair.right) for pair in pairs), serials)
