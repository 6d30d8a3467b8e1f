"""Record of every trigger, which identifies the exposure of any frame by its bytes.

The noise of every exposure has its own seed, so no two images of a run are equal: a frame that equals an image byte by
byte is that exposure. The images hold no marks.
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
class Trigger:
    """One trigger of the world.

    Args:
        index: 0 for the first one; it is the seed of the noise too.
        t_ns: the edge on both trigger lines, CLOCK_MONOTONIC.
        image: digest of the projected image; dark: it was black because no display answered.
        instant: of the scene.
        faults: of each side's frame.
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
    """The last triggers, and counts since the start. For any thread.

    Args:
        keep: number of triggers kept.
    """

    def __init__(self, *, keep: int = 4096) -> None:
        if keep < 1:
            raise ValueError(f"keep is {keep}, expected at least 1")
        self._lock = threading.Lock()
        self._keep = keep
        self._shown: deque[Trigger] = deque()
        self._of_bytes: dict[tuple[Side, bytes], Trigger] = {}
        self._counts: Counter[tuple[Side, FaultKind]] = Counter()
        self._dark = 0

    def note(self, shown: Trigger) -> None:
        """Record a trigger, before its edges."""
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

    def exposure_of(self, side: Side, image: NDArray[np.generic]) -> Trigger | None:
        """The trigger whose exposure a frame is, byte by byte; None if it is none of those kept."""
        key = side, digest(image)
        with self._lock:
            return self._of_bytes.get(key)

    @property
    def last(self) -> Trigger | None:
        """The latest trigger."""
        with self._lock:
            return self._shown[-1] if self._shown else None

    @property
    def triggers(self) -> list[Trigger]:
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
