"""Simulated projectors: one for a rendered loop, with a single image, and one that shows any image."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from drivers.errors import DriverError, SettingRefused
from drivers.protocols import ProjectorInfo


class SimProjector:
    """Shows the image that the loop was rendered with, or black.

    Before it is opened, it shows the image.

    Args:
        image: (H, W, 3) uint8, of the loop.
    """

    def __init__(self, image: NDArray[np.uint8]) -> None:
        self._image = image
        self._open = False
        self._lit = True

    @property
    def lit(self) -> bool:
        """Whether the pattern is shown."""
        return self._lit

    def open(self) -> ProjectorInfo:
        """Connect; the image is black until :meth:`show`."""
        self._open, self._lit = True, False
        height, width = self._image.shape[:2]
        return ProjectorInfo("simulated", (width, height), 0.0)

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show the rendered image (within one level: rounding may differ) or a black one."""
        if not self._open:
            raise DriverError("projector: show() while closed; open() comes first")
        if image.shape != self._image.shape or image.dtype != np.uint8:
            raise SettingRefused(
                f"projector: image {image.shape} {image.dtype} does not fit, expected {self._image.shape} uint8"
            )
        if not image.any():
            self._lit = False
        elif np.abs(image.astype(np.int16) - self._image).max() <= 1:
            self._lit = True
        else:
            raise SettingRefused(
                "projector: the simulated rig plays a loop rendered with its own pattern and cannot show another "
                "image; a live one can: fringed demo --live, or simulation.live: true in rig.yaml"
            )

    def problem(self) -> str:
        """Always empty."""
        return ""

    def close(self) -> None:
        """Show black and disconnect."""
        self._open, self._lit = False, False


class LiveProjector:
    """Shows any image of its size.

    Before it is opened, it shows ``first``.

    Args:
        first: (H, W, 3) uint8.
    """

    lit = True  # A black image is rendered like any other.

    def __init__(self, first: NDArray[np.uint8]) -> None:
        self._black = _frozen(np.zeros_like(first))
        self._shown = _frozen(first)
        self._stored: list[tuple[NDArray[np.uint8], bytes]] = []
        self._first = 0
        self._open = False

    @property
    def shown(self) -> tuple[NDArray[np.uint8], bytes]:
        """The image that is shown, read-only, and its digest."""
        return self._shown

    def shown_at(self, index: int) -> tuple[NDArray[np.uint8], bytes]:
        """The image at trigger ``index``, and its digest."""
        stored = self._stored
        return stored[(index - self._first) % len(stored)] if stored else self._shown

    def store(self, images: Sequence[NDArray[np.uint8]], first: int = 0) -> None:
        """Show these images, one a trigger, the first at trigger ``first``; :meth:`show` ends it."""
        self._first, self._stored = first, [_frozen(image) for image in images]

    def open(self) -> ProjectorInfo:
        """Connect; the image is black until :meth:`show`."""
        self._open, self._shown, self._stored = True, self._black, []
        height, width = self._black[0].shape[:2]
        return ProjectorInfo("simulated", (width, height), 0.0, latency_s=0.0)

    def show(self, image: NDArray[np.uint8]) -> None:
        """Show an image from the next trigger on."""
        if not self._open:
            raise DriverError("projector: show() while closed; open() comes first")
        expected = self._black[0].shape
        if image.shape != expected or image.dtype != np.uint8:
            raise SettingRefused(
                f"projector: image {image.shape} {image.dtype} does not fit, expected {expected} uint8"
            )
        self._shown, self._stored = _frozen(image), []

    def problem(self) -> str:
        """Always empty."""
        return ""

    def close(self) -> None:
        """Show black and disconnect."""
        self._open, self._shown, self._stored = False, self._black, []


def _frozen(image: NDArray[np.uint8]) -> tuple[NDArray[np.uint8], bytes]:
    copy = np.array(image, order="C")
    copy.setflags(write=False)
    return copy, hashlib.blake2b(copy.data, digest_size=16).digest()
