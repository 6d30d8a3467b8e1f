"""Paint known pixels on an X screen."""

from __future__ import annotations

import ctypes
from ctypes import c_int16, c_uint8, c_uint16, c_uint32, c_void_p

import numpy as np
from numpy.typing import NDArray

from sim.box.xcb import Cookie, load

_MOST_BYTES = 200_000


class Painter:
    """A client of its own that writes into the root window."""

    def __init__(self, display: str) -> None:
        self._xcb = load()
        self._raw = ctypes.CDLL("libxcb.so.1")
        self._raw.xcb_create_gc.argtypes = (c_void_p, c_uint32, c_uint32, c_uint32, c_void_p)
        self._raw.xcb_create_gc.restype = Cookie
        self._raw.xcb_put_image_checked.argtypes = (
            c_void_p, c_uint8, c_uint32, c_uint32, c_uint16, c_uint16, c_int16, c_int16, c_uint8, c_uint8, c_uint32,
            c_void_p,
        )  # fmt: skip
        self._raw.xcb_put_image_checked.restype = Cookie
        self._connection = self._xcb.connect(display)
        assert not self._xcb.has_error(self._connection)
        self._screen = self._xcb.screen(self._connection)
        self._context = self._xcb.generate_id(self._connection)
        self._raw.xcb_create_gc(self._connection, self._context, self._screen.root, 0, None)

    def paint(self, image: NDArray[np.uint8], x: int = 0, y: int = 0) -> None:
        """Write (H, W, 3) pixels, R G B, at a place of the screen; they are there on return."""
        height, width = image.shape[:2]
        rows = max(1, _MOST_BYTES // (4 * width))
        for first in range(0, height, rows):
            part = image[first : first + rows]
            pixels = np.zeros((*part.shape[:2], 4), np.uint8)
            pixels[..., :3] = part[..., ::-1]
            cookie = self._raw.xcb_put_image_checked(
                self._connection, 2, self._screen.root, self._context, width, len(part), x, y + first, 0, 24,
                pixels.nbytes, pixels.ctypes.data,
            )  # fmt: skip
            assert not self._xcb.request_check(self._connection, cookie)

    def close(self) -> None:
        self._xcb.disconnect(self._connection)
