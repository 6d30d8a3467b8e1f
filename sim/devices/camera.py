"""A simulated camera: the drivers' protocol on a bounded queue that the simulated world fills."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from enum import StrEnum

from drivers.errors import DeviceLost, DriverError
from drivers.protocols import CameraHealth, CameraInfo, Frame, Side


class CameraState(StrEnum):
    """See the state diagram of the protocol."""

    CLOSED = "closed"
    IDLE = "idle"
    ACQUIRING = "acquiring"


class SimCamera:
    """One side of the simulated rig; created by the world, read by one thread.

    Args:
        side: which camera.
        size: (width, height), pixels.
        encoding: of its frames.
        queue_frames: unread frames in the queue; a further one displaces the oldest, which is counted.
        dropped: called with each frame that is discarded unread, and the reason (``overflow`` or ``dropped``).
        started: called when the camera begins to accept triggers.
        note: on the origin of the images.
    """

    def __init__(
        self,
        side: Side,
        size: tuple[int, int],
        encoding: str,
        *,
        queue_frames: int = 8,
        dropped: Callable[[Frame, str], None] | None = None,
        started: Callable[[], None] | None = None,
        note: str = "simulated: images come from a rendered loop",
    ) -> None:
        self.side, self.size, self.encoding, self.note = side, size, encoding, note
        self._queue: deque[Frame] = deque()
        self._queue_frames = queue_frames
        self._dropped, self._started = dropped, started
        self._changed = threading.Condition()
        self._state = CameraState.CLOSED
        self._present = True
        self._lost = False
        self._counters = {"received": 0, "overflow": 0, "dropped": 0, "lost_device": 0}

    @property
    def state(self) -> CameraState:
        """State of the camera."""
        return self._state

    def health(self) -> CameraHealth:
        """Counters: frames received, displaced from the queue, dropped unread, and losses of the device."""
        with self._changed:
            return CameraHealth(counters=dict(self._counters))

    def open(self) -> CameraInfo:
        """Connect; DeviceLost while the device is unplugged."""
        with self._changed:
            if not self._present:
                raise DeviceLost(f"camera {self.side}: the simulated device is unplugged; open it again later")
            if self._state is not CameraState.CLOSED:
                raise DriverError(f"camera {self.side}: open() while {self._state}; close() it first")
            self._state, self._lost = CameraState.IDLE, False
            return CameraInfo("simulated", f"sim-{self.side}", self.size, self.encoding, notes=(self.note,))

    def start(self) -> None:
        """Begin to accept triggers."""
        with self._changed:
            self._check_lost()
            if self._state is not CameraState.IDLE:
                raise DriverError(f"camera {self.side}: start() while {self._state}; open() comes first")
            self._state = CameraState.ACQUIRING
        if self._started is not None:
            self._started()

    def read(self, timeout_s: float) -> Frame | None:
        """The next frame in the order of arrival, or None when none arrived in time."""
        with self._changed:
            if self._state is not CameraState.ACQUIRING and not self._lost:
                raise DriverError(f"camera {self.side}: read() while {self._state}; start() comes first")
            self._changed.wait_for(
                lambda: bool(self._queue) or self._lost or self._state is not CameraState.ACQUIRING, timeout_s
            )
            self._check_lost()
            return self._queue.popleft() if self._queue else None

    def stop(self) -> None:
        """Stop accepting triggers; frames not yet read are dropped."""
        with self._changed:
            if self._state is CameraState.ACQUIRING:
                self._state = CameraState.IDLE
            self._drop_all()
            self._changed.notify_all()

    def close(self) -> None:
        """Disconnect."""
        with self._changed:
            self._state, self._lost = CameraState.CLOSED, False
            self._drop_all()
            self._changed.notify_all()

    def deliver(self, frame: Frame) -> bool:
        """The world's side: deliver a frame; False when the camera does not acquire."""
        with self._changed:
            if self._state is not CameraState.ACQUIRING or not self._present:
                return False
            if len(self._queue) >= self._queue_frames:
                self._drop_oldest("overflow")
            self._queue.append(frame)
            self._counters["received"] += 1
            self._changed.notify_all()
            return True

    def set_present(self, present: bool) -> None:
        """The world's side: plug or unplug the device."""
        with self._changed:
            if self._present and not present and self._state is not CameraState.CLOSED:
                self._lost, self._state = True, CameraState.CLOSED
                self._counters["lost_device"] += 1
                self._drop_all()
            self._present = present
            self._changed.notify_all()

    def _check_lost(self) -> None:
        if self._lost:
            self._lost = False
            raise DeviceLost(f"camera {self.side}: the simulated device was unplugged; open it again to recover")

    def _drop_all(self) -> None:
        while self._queue:
            self._drop_oldest("dropped")

    def _drop_oldest(self, reason: str) -> None:
        frame = self._queue.popleft()
        self._counters[reason] += 1
        if self._dropped is not None:
            self._dropped(frame, reason)
