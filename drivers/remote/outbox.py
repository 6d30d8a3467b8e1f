"""The slots of the ring on the camera's side: free, filling, waiting, announced, or in use by the daemon."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import Frame
from drivers.remote.messages import FrameReady
from drivers.remote.ring import RingWriter

WINDOW = 2
"""Frames announced and not yet taken; further ones wait here, where the oldest can still be dropped."""

Image = NDArray[Any]


class Outbox:
    """A bounded queue of frames in slots that drops the oldest; slots come back after use.

    Args:
        ring: where the frames lie.
        announce: sends a message to the daemon.
    """

    def __init__(self, ring: RingWriter, announce: Callable[[FrameReady], None]) -> None:
        self._ring, self._announce = ring, announce
        self._free = list(range(ring.slots))
        self._waiting: deque[FrameReady] = deque()
        self._announced: set[int] = set()
        self._filling: tuple[int, Image] | None = None
        self.ring_full = 0

    @property
    def waiting(self) -> int:
        """Number of frames that are not announced yet."""
        return len(self._waiting)

    def allocate(self, shape: tuple[int, ...], dtype: Any) -> Image:
        """Return memory for an image, in the ring where a slot is free; a driver that fills it saves a copy."""
        if self._filling is not None:
            index = self._filling[0]
        else:
            slot = self._take_slot()
            if slot is None:
                return np.empty(shape, dtype)
            index = slot
        image = self._ring.slot(index, shape, np.dtype(dtype))
        self._filling = (index, image)
        return image

    def put(self, frame: Frame) -> None:
        """Queue a frame, or count it as lost."""
        index = self._store(frame.image)
        if index is None:
            self.ring_full += 1
            return
        self._waiting.append(
            FrameReady(
                slot=index,
                trigger=frame.trigger,
                t_exposure_ns=frame.t_exposure_ns,
                t_host_ns=frame.t_host_ns,
                encoding=frame.encoding,
                shape=frame.image.shape,
                wide=frame.image.dtype == np.uint16,
                exposure_us=frame.exposure_us,
                t_device_ns=frame.t_device_ns,
                frame_id=frame.frame_id,
            )
        )
        self._announce_waiting()

    def taken(self, slot: int, *, kept: bool) -> None:
        """Handle that the daemon has taken an announced frame; ``kept``: it still uses the slot."""
        self._announced.discard(slot)
        if not kept:
            self.release(slot)
        self._announce_waiting()

    def release(self, slot: int) -> None:
        """Make a slot available again."""
        self._free.append(slot)

    def clear(self) -> None:
        """Discard the waiting frames; the camera was stopped."""
        while self._waiting:
            self._free.append(self._waiting.popleft().slot)

    def _store(self, image: Image) -> int | None:
        filling, self._filling = self._filling, None
        if filling is not None and image is filling[1]:
            return filling[0]
        index = filling[0] if filling is not None else self._take_slot()
        if index is not None:
            self._ring.slot(index, image.shape, image.dtype)[...] = image
        return index

    def _take_slot(self) -> int | None:
        if self._free:
            return self._free.pop()
        if self._waiting:
            self.ring_full += 1
            return self._waiting.popleft().slot
        return None

    def _announce_waiting(self) -> None:
        while self._waiting and len(self._announced) < WINDOW:
            ready = self._waiting.popleft()
            self._announced.add(ready.slot)
            self._announce(ready)
