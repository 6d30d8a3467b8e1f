"""What was shown at each trigger, so that any frame can be told which exposure it is by nothing but its bytes.

The noise of every exposure has a seed of its own, so no two images of a run are equal; a frame that equals an image
byte by byte is that exposure. Nothing is hidden in the images.
"""

from __future__ import annotations

import hashlib
import threading
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.protocols import SIDES, Side
from sim.devices.faults import FaultKind

_DIGEST_BYTES = 16


def digest(pixels: NDArray[np.generic]) -> bytes:
    """Digest of an array's bytes, 16 bytes."""
    data = np.ascontiguousarray(pixels).view(np.uint8).data
    return hashlib.blake2b(data, digest_size=_DIGEST_BYTES, usedforsecurity=False).digest()


@dataclass(frozen=True, slots=True)
class Shown:
    """One trigger of the world.

    Args:
        index: 0 for the first one; it is the seed of the noise too.
        t_ns: the edge on both trigger lines, CLOCK_MONOTONIC.
        image: digest of what the projector showed; dark: it was black because no display answered.
        instant: of the scene.
        faults: what befell each side's frame.
        exposures: digest of the image on each sensor.
    """

    index: int
    t_ns: int
    image: bytes
    dark: bool
    instant: int
    faults: Mapping[Side, FaultKind]
    exposures: Mapping[Side, bytes]


class Ledger:
    """The last triggers and what was shown at each; counts of everything since the start. For any thread.

    Args:
        keep: triggers that are remembered.
    """

    def __init__(self, *, keep: int = 4096) -> None:
        if keep < 1:
            raise ValueError(f"keep is {keep}, expected at least 1")
        self._lock = threading.Lock()
        self._keep = keep
        self._shown: deque[Shown] = deque()
        self._of_bytes: dict[tuple[Side, bytes], Shown] = {}
        self._counts: Counter[tuple[Side, FaultKind]] = Counter()
        self._dark = 0

    def note(self, shown: Shown) -> None:
        """Write a trigger down, before its edges are given."""
        with self._lock:
            if len(self._shown) == self._keep:
                oldest = self._shown.popleft()
                for side in SIDES:
                    self._of_bytes.pop((side, oldest.exposures[side]), None)
            self._shown.append(shown)
            for side in SIDES:
                self._of_bytes[side, shown.exposures[side]] = shown
                self._counts[side, shown.faults[side]] += 1
            self._dark += shown.dark

    def exposure_of(self, side: Side, image: NDArray[np.generic]) -> Shown | None:
        """The trigger whose exposure a frame is, byte by byte; None if it is none of those remembered."""
        key = side, digest(image)
        with self._lock:
            return self._of_bytes.get(key)

    @property
    def last(self) -> Shown | None:
        """The latest trigger."""
        with self._lock:
            return self._shown[-1] if self._shown else None

    @property
    def remembered(self) -> list[Shown]:
        """The last triggers in their order."""
        with self._lock:
            return list(self._shown)

    @property
    def counts(self) -> dict[tuple[Side, FaultKind], int]:
        """Triggers by side and fault since the start; those without one are of kind ``none``."""
        with self._lock:
            return dict(self._counts)

    @property
    def dark(self) -> int:
        """Triggers since the start at which no display answered."""
        with self._lock:
            return self._dark
