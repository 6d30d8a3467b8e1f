"""The light on a sensor, shared with the camera's process: a ring of the last images."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from sim.gentl import memory

Image = NDArray[np.uint8] | NDArray[np.uint16]


class Images:
    """A ring of images in a file of its own.

    The writer makes a slot's sequence odd, writes the image, and makes it even; the reader copies and checks
    that the sequence is unchanged. Neither waits for the other, and a partly written image is never used.

    Args:
        path: a new file; size: (width, height) of the sensor.
    """

    def __init__(self, path: Path, size: tuple[int, int]) -> None:
        self.shown = 0
        self._size = size
        self._slot_bytes = memory.SLOT_HEADER + size[0] * size[1] * 3 * 2
        self._bytes = memory.create_shared(path, memory.SLOT_HEADER + memory.SLOTS * self._slot_bytes)
        self._header = self._bytes[: memory.IMAGE_DTYPE.itemsize].view(memory.IMAGE_DTYPE)[0]
        self._header["slots"], self._header["slot_bytes"] = memory.SLOTS, self._slot_bytes
        self._header["width"], self._header["height"] = size
        self._header["magic"] = memory.IMAGE_MAGIC

    def show(self, image: Image) -> int:
        """Write the next image and return its number from 1; see :meth:`sim.gentl.cable.Cable.show`."""
        width, height = self._size
        if image.shape not in ((height, width), (height, width, 3)) or image.dtype not in (np.uint8, np.uint16):
            raise ValueError(
                f"the sensor takes ({height}, {width}) or ({height}, {width}, 3), uint8 or uint16; "
                f"got {image.shape}, {image.dtype}"
            )
        number = self.shown + 1
        start = memory.SLOT_HEADER + number % memory.SLOTS * self._slot_bytes
        slot = self._bytes[start : start + self._slot_bytes]
        header = slot[: memory.SLOT_DTYPE.itemsize].view(memory.SLOT_DTYPE)[0]
        header["sequence"] = 2 * number - 1
        header["channels"] = 3 if image.ndim == 3 else 1
        header["bytes_per_sample"] = image.dtype.itemsize
        pixels = slot[memory.SLOT_HEADER : memory.SLOT_HEADER + image.nbytes].view(image.dtype)
        np.copyto(pixels.reshape(image.shape), image)
        header["sequence"] = 2 * number
        self._header["newest"] = number
        self.shown = number
        return number
