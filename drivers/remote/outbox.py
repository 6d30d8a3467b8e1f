"""What becomes of the slots of the ring, on the camera's side: free, filling, waiting, announced, or looked at."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import Frame
from drivers.remote.messages import Ready
from drivers.remote.ring import RingWriter

WINDOW = 2
"""Frames announced and not yet taken; the others wait here, where the oldest can still be dropped."""

Image = NDArray[Any]


class Outbox:
    """Bounded, oldest dropped: a frame goes into a slot, waits, is announced and comes back.

    Args:
        ring: where the frames lie.
        announce: sends a message to the daemon.
    """

    def __init__(self, ring: RingWriter, announce: Callable[[Ready], None]) -> None:
        self._ring, self._announce = ring, announce
        self._free = list(range(ring.slots))
        self._waiting: deque[Ready] = deque()
        self._announced: set[int] = set()
        self._filling: tuple[int, Image] | None = None
        self.ring_full = 0

    @property
    def waiting(self) -> int:
        """Frames that the daemon has not been told of."""
        return len(self._waiting)

    def allocate(self, shape: tuple[int, ...], dtype: Any) -> Image:
        """Memory for an image, in the ring where there is room; a driver that fills it saves a copy."""
        if self._filling is not None:
            index = self._filling[0]
        else:
            found = self._claim()
            if found is None:
                return np.empty(shape, dtype)
            index = found
        image = self._ring.slot(index, shape, np.dtype(dtype))
        self._filling = (index, image)
        return image

    def put(self, frame: Frame) -> None:
        """Pass a frame on, or count it as lost."""
        index = self._place(frame.image)
        if index is None:
            self.ring_full += 1
            return
        self._waiting.append(
            Ready(
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
        self._tell()

    def took(self, slot: int, *, kept: bool) -> None:
        """The daemon has taken an announced frame."""
        self._announced.discard(slot)
        if not kept:
            self.returned(slot)
        self._tell()

    def returned(self, slot: int) -> None:
        """A slot may be filled again."""
        self._free.append(slot)

    def clear(self) -> None:
        """Forget the frames that wait; the camera was stopped."""
        while self._waiting:
            self._free.append(self._waiting.popleft().slot)

    def _place(self, image: Image) -> int | None:
        filling, self._filling = self._filling, None
        if filling is not None and image is filling[1]:
            return filling[0]
        index = filling[0] if filling is not None else self._claim()
        if index is not None:
            self._ring.slot(index, image.shape, image.dtype)[...] = image
        return index

    def _claim(self) -> int | None:
        if self._free:
            return self._free.pop()
        if self._waiting:
            self.ring_full += 1
            return self._waiting.popleft().slot
        return None

    def _tell(self) -> None:
        while self._waiting and len(self._announced) < WINDOW:
            ready = self._waiting.popleft()
            self._announced.add(ready.slot)
            self._announce(ready)
