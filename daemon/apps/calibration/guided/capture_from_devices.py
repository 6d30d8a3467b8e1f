"""Capture with the rig's own devices, where no daemon runs, such as for a rig without a calibration."""

from __future__ import annotations

import time
from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

from daemon.apps.calibration.guided.capture import CapturedImages, Progress, no_progress
from daemon.common.clock import SystemClock
from daemon.common.counters import Counters
from daemon.common.errors import DaemonError
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import RigConfig
from daemon.live.acquisition.camera_thread import CameraThread
from daemon.live.acquisition.locked_pairer import LockedPairer, pairing_settings
from daemon.live.items import Pair
from daemon.live.projection.confirmed_capture import ConfirmedCapture, patience_s, settling_ns
from drivers.errors import DriverError
from drivers.protocols import SIDES, Clock, Devices, Side
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.calibration import Response

_START_S, _TICK_S = 15.0, 0.05


class CaptureFromDevices:
    """Owns the devices of a rig from construction to :meth:`close`.

    Args:
        devices: cameras and projector of :func:`daemon.rig.open_rig.open_devices`, not opened.
        config: of the rig, for the pairing. response: of the projector, for frames that are given as light.

    Raises:
        DriverError: no projector. DaemonError: a camera delivers no frames.
    """

    def __init__(
        self,
        devices: Devices,
        config: RigConfig,
        *,
        response: Response | None = None,
        clock: Clock | None = None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> None:
        self._devices, self._response, clock = devices, response, clock or SystemClock()
        self._cameras: dict[Side, CameraThread] = {}
        limits = pairing_settings(config.pairing)
        self._pose: Any = None
        queue: LatestWinsQueue[Pair] = LatestWinsQueue(4)
        pairer = LockedPairer(limits, paired=queue.put, unpaired=lambda _: None, drops=Counters(), clock=clock)
        try:
            self._projector = devices.projector.open()
            self._open_cameras(pairer, clock)
            settle_ns = settling_ns(self._projector, tolerance_ns=limits.tolerance_ns)
            self._confirmed = ConfirmedCapture(
                devices.projector,
                self._projector,
                queue,
                clock=clock,
                settle_ns=settle_ns,
                patience_s=patience_s(rendered=devices.board is not None),
                cancelled=cancelled,
            )
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the projector, pixels."""
        return self._projector.size

    def capture(self, sequence: FrameSequence, *, progress: Progress = no_progress) -> CapturedImages:
        """Capture a pair for each frame, see :class:`daemon.apps.calibration.guided.capture.ImageCapture`."""
        pairs: list[Pair] = []
        try:
            for pair in self._confirmed.each(frame.image(self._response) for frame in sequence.frames):
                pairs.append(pair)
                progress(len(pairs), len(sequence))
        except DriverError as error:
            lost = [f"camera {side}: {c.status.problem}" for side, c in self._cameras.items() if c.status.problem]
            raise DriverError("; ".join([*lost, str(error)])) from error
        return CapturedImages(
            pairs[0].left.encoding,
            tuple((pair.left.image, pair.right.image) for pair in pairs),
            {side: camera.status.serial for side, camera in self._cameras.items() if camera.status.serial},
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, whole sentences."""
        if self._projector.latency_s is not None:
            return ()
        return (
            "the projector's latency is unknown, so every capture waits longer than necessary; "
            "`fringed projector latency RIG --write` measures it",
        )

    @property
    def has_hand(self) -> bool:
        """Whether a simulated hand, not a person, holds the board."""
        return self._devices.board is not None

    def next_pose(self) -> bool:
        """Move the board to the simulated hand's next pose; False after the last pose, or without a simulated hand."""
        if self._devices.board is None:
            return False
        before, self._pose = self._pose, self._devices.board.next_pose()
        return self._pose is None or self._pose != before

    def close(self) -> None:
        """Stop projecting and close the devices."""
        for camera in self._cameras.values():
            camera.request_stop()
        for camera in self._cameras.values():
            camera.join(5.0)
        self._devices.projector.close()
        self._devices.close()

    def _open_cameras(self, pairer: LockedPairer, clock: Clock) -> None:
        for side in SIDES:
            self._cameras[side] = CameraThread(
                side,
                self._devices.cameras[side],
                deliver=pairer.receive,
                started=pairer.camera_restarted,
                changed=lambda: None,
                clock=clock,
            )
            self._cameras[side].start()
        end_s = time.monotonic() + _START_S
        for side, camera in self._cameras.items():
            while not camera.status.encoding:
                if time.monotonic() > end_s:
                    problem = camera.status.problem or f"no frame within {_START_S:g} s"
                    raise DaemonError(f"camera {side}: {problem}; `fringed doctor` examines it")
                time.sleep(_TICK_S)
        encodings = {side: camera.status.encoding for side, camera in self._cameras.items()}
        if len(set(encodings.values())) != 1:
            raise DaemonError(f"the cameras have the encodings {encodings}, expected the same one")
