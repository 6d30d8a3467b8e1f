"""One thread for each camera: opens it, reads it, and opens it again after the device was lost."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from dataclasses import replace

from daemon.common.counters import Rate
from daemon.common.heartbeat import Heartbeat
from daemon.live.acquisition.camera_status import CameraState, CameraStatus
from drivers.errors import DriverError
from drivers.protocols import Camera, Clock, Frame, Side

log = logging.getLogger("fringed.camera")

_READ_TIMEOUT_S = 0.2
_FIRST_WAIT_S, _LONGEST_WAIT_S = 0.2, 5.0
_TURN_S, _DEVICE_S = 10.0, 120.0  # longest times of a turn, and of opening, starting and closing a device


class CameraThread:
    """Owns a camera from open to close.

    Args:
        side: which one; camera: closed.
        deliver: takes each frame; must be quick. started: called before the camera accepts triggers (again).
        changed: called whenever the camera's state changes.
    """

    def __init__(
        self,
        side: Side,
        camera: Camera,
        *,
        deliver: Callable[[Frame], None],
        started: Callable[[Side], None],
        changed: Callable[[], None],
        clock: Clock,
    ) -> None:
        self.side = side
        self._camera, self._deliver, self._changed, self._clock = camera, deliver, changed, clock
        self._status = CameraStatus(CameraState.CLOSED)
        self._started = started
        self._rate = Rate()
        self._frames = 0
        self.heartbeat = Heartbeat(clock.monotonic_ns)
        self._enabled = threading.Event()
        self._enabled.set()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=f"camera-{side}", daemon=True)

    @property
    def status(self) -> CameraStatus:
        """Of the camera; without the outcomes of its frames, which the pairer counts."""
        rate, health = self._rate.per_second(self._clock.monotonic_ns()), self._camera.health()
        return replace(
            self._status,
            rate_hz=round(rate, 2),
            frames=self._frames,
            driver=dict(health.counters),
            temperature_c=health.temperature_c,
        )

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def measure(self, enabled: bool) -> None:
        """Accept triggers, or stay connected without accepting them."""
        (self._enabled.set if enabled else self._enabled.clear)()

    def request_stop(self) -> None:
        """Request the end; :meth:`join` waits for it."""
        self._stop.set()

    def join(self, timeout_s: float) -> bool:
        """Wait for the end; False when the driver hangs."""
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        wait_s = _FIRST_WAIT_S
        while not self._stop.is_set():
            self.heartbeat.expect(_DEVICE_S)
            try:
                self._open()
                wait_s = _FIRST_WAIT_S
                while not self._stop.is_set():
                    self._acquire()
            except DriverError as error:
                self._lost(str(error))
            except Exception as error:  # a driver's bug must not take the daemon down
                log.exception("camera %s: unexpected error", self.side, extra={"side": self.side})
                self._lost(f"{type(error).__name__}: {error}")
            finally:
                self.heartbeat.expect(_DEVICE_S)
                self._camera.close()
            self.heartbeat.expect(wait_s + _TURN_S)
            self._stop.wait(wait_s)
            wait_s = min(2 * wait_s, _LONGEST_WAIT_S)
        self.heartbeat.rest()
        self._set(replace(self._status, state=CameraState.CLOSED))

    def _open(self) -> None:
        info = self._camera.open()
        for note in info.notes:
            log.info("camera %s: %s", self.side, note, extra={"side": self.side})
        self._set(
            replace(
                self._status,
                state=CameraState.PAUSED,
                model=info.model,
                serial=info.serial,
                encoding=info.encoding,
                size=info.size,
                exposure_us=info.exposure_us,
                problem="",
            )
        )

    def _acquire(self) -> None:
        """Read until a pause or stop is requested; waits while paused."""
        self.heartbeat.expect(_TURN_S)
        if not self._enabled.wait(_READ_TIMEOUT_S):
            return
        self._started(self.side)
        self.heartbeat.expect(_DEVICE_S)
        self._camera.start()
        self._set(replace(self._status, state=CameraState.ACQUIRING))
        while self._enabled.is_set() and not self._stop.is_set():
            self.heartbeat.expect(_TURN_S)
            frame = self._camera.read(_READ_TIMEOUT_S)
            if frame is not None:
                self._frames += 1
                self._rate.note(self._clock.monotonic_ns())
                self._deliver(frame)
        self.heartbeat.expect(_DEVICE_S)
        self._camera.stop()
        self._set(replace(self._status, state=CameraState.PAUSED))

    def _lost(self, problem: str) -> None:
        first = self._status.state is not CameraState.LOST
        if first:
            log.warning("camera %s is lost: %s", self.side, problem, extra={"side": self.side, "reason": problem})
        losses = self._status.losses + first
        self._set(replace(self._status, state=CameraState.LOST, problem=problem, losses=losses))

    def _set(self, status: CameraStatus) -> None:
        changed = status.state is not self._status.state
        self._status = status
        if changed:
            self._changed()
