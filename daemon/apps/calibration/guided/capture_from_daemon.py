"""Shooting through a daemon that runs already: its control methods ``calibrate.*``."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from daemon.apps.calibration.guided.capture import Progress, Shots, unheard
from daemon.common.errors import ControlError, DaemonError
from daemon.control.rpc.client import ControlClient
from daemon.live.projection.confirmed_capture import CaptureCancelledError
from daemon.recording.read.take_reader import TakeReader
from pipeline.pattern.sequence import FrameSequence

HOLD_S = 20.0
"""So long the daemon keeps the last image between two captures; longer pauses only cost the time to begin again."""
_POLL_S = 0.03
_LONGEST_SILENCE_S = 120.0


class DaemonShooter:
    """Asks the daemon behind a control endpoint; the files it writes are read on the same machine.

    Args:
        client: connected; closed at the end.

    Raises:
        ControlError: no daemon answers there. DaemonError: it is still starting.
    """

    def __init__(self, client: ControlClient, *, cancelled: Callable[[], bool] = lambda: False) -> None:
        self._client, self._cancelled = client, cancelled
        told = client.call("calibrate.status")
        size, self._has_hand = told.get("projector"), bool(told.get("hand"))
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

    def shoot(self, sequence: FrameSequence, *, progress: Progress = unheard) -> Shots:
        """A pair for each frame, see :class:`daemon.apps.calibration.guided.capture.Shooter`."""
        frames = [frame.as_mapping() for frame in sequence.frames]
        job = self._client.call("calibrate.capture", frames=frames, name=sequence.name, hold_s=HOLD_S)["job"]
        told = self._wait(job, progress)
        if told["outcome"] == "cancelled":
            raise CaptureCancelledError("the capture was cancelled")
        if told["outcome"] != "done":
            raise DaemonError(str(told["problem"]))
        return _read(Path(told["file"]), len(sequence))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the person should know, in sentences."""
        return ("the daemon measures with its old calibration until it is started anew",)

    @property
    def has_hand(self) -> bool:
        """Whether a simulated hand holds the board, not a person."""
        return self._has_hand

    def next_pose(self) -> bool:
        """Let the simulated hand move the board on; False once it has shown all its poses, or where there is none."""
        if not self._has_hand:
            return False
        before, self._pose = self._pose, self._client.call("calibrate.next_pose")["pose"]
        return self._pose is None or self._pose != before

    def close(self) -> None:
        """Let the daemon measure again."""
        try:
            self._client.call("calibrate.cancel")
        except ControlError:
            pass  # the daemon has gone; there is nothing to let go of
        finally:
            self._client.close()

    def _wait(self, job: int, progress: Progress) -> dict[str, Any]:
        done, since_s = -1, time.monotonic()
        while True:
            told: dict[str, Any] = self._client.call("calibrate.status")
            if told["job"] != job:
                raise DaemonError(f"somebody else captures through {self._client.endpoint} (job {told['job']})")
            if told["done"] != done:
                done, since_s = told["done"], time.monotonic()
                progress(done, told["of"])
            if told["outcome"]:
                return told
            if self._cancelled() or time.monotonic() - since_s > _LONGEST_SILENCE_S:
                self._client.call("calibrate.cancel")
                raise CaptureCancelledError("the capture was cancelled")
            time.sleep(_POLL_S)


def _read(path: Path, frames: int) -> Shots:
    with TakeReader(path) as take:
        pairs = sorted(take.pairs(), key=lambda pair: pair.sequence)
        numbers = [pair.sequence for pair in pairs]
        if numbers != list(range(frames)):
            first = numbers[0] if numbers else 0
            raise DaemonError(f"{path}: {len(pairs)} of {frames} images are there, numbered from {first}")
    return Shots(pairs[0].encoding, tuple((pair.left, pair.right) for pair in pairs))
