"""Encodings of raw images, and checks of incoming images."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import ImageError

BAYER: dict[str, tuple[tuple[int, int], tuple[int, int]]] = {
    "bayer_rggb8": ((0, 1), (1, 2)),
    "bayer_bggr8": ((2, 1), (1, 0)),
    "bayer_gbrg8": ((1, 2), (0, 1)),
    "bayer_grbg8": ((1, 0), (2, 1)),
}
"""Channel (0 red, 1 green, 2 blue) at (row parity, column parity)."""

ENCODINGS = ("rgb8", *BAYER)


def mosaic_of(encoding: str) -> NDArray[np.int64] | None:
    """(2, 2) channel numbers of a Bayer mosaic, None for a three-chip image."""
    if encoding not in ENCODINGS:
        raise ImageError(f"encoding {encoding!r} carries no three colours; expected one of {', '.join(ENCODINGS)}")
    return None if encoding == "rgb8" else np.array(BAYER[encoding], dtype=np.int64)


def checked(image: NDArray[Any], side: str, encoding: str, size: tuple[int, int]) -> NDArray[np.uint8]:
    """The image as a contiguous uint8 array of the calibrated size, else ImageError."""
    width, height = size
    shape = (height, width, 3) if encoding == "rgb8" else (height, width)
    if image.shape != shape or image.dtype != np.uint8:
        raise ImageError(
            f"{side} image is {image.dtype} {image.shape}, but {encoding} of the calibrated camera is uint8 {shape}; "
            "use the calibration of this camera and its region of interest"
        )
    return read_only(np.ascontiguousarray(image))


def read_only(image: NDArray[Any]) -> NDArray[Any]:
    """A read-only view: numba compiles a kernel once more for writable arrays, which would happen mid-run."""
    view = image.view()
    view.setflags(write=False)
    return view
