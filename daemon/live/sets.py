"""A set: one pair of images for each image of a sequence, in its order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from daemon.live.acquisition.pairer import Pair
from drivers.protocols import Frame

SINGLE = "single"
"""The mode in which a single image makes a cloud."""


@dataclass(frozen=True, slots=True, eq=False)
class ImageSet:
    """What the pipeline measures at once in a multi-frame mode.

    Args:
        pairs: one an image, in the order of the sequence; mode: name of the mode whose images they show.
    """

    pairs: tuple[Pair, ...]
    mode: str

    @property
    def seq(self) -> int:
        """Number of the first image's trigger."""
        return self.pairs[0].seq

    @property
    def left(self) -> Frame:
        """The newest left frame."""
        return self.pairs[-1].left

    @property
    def right(self) -> Frame:
        """The newest right frame."""
        return self.pairs[-1].right

    @property
    def t_ns(self) -> int:
        """Start of the first exposure, CLOCK_REALTIME."""
        return self.pairs[0].left.t_exposure_ns

    @property
    def span_ms(self) -> float:
        """From the start of the first exposure to the start of the last one."""
        return (self.pairs[-1].left.t_exposure_ns - self.t_ns) / 1e6

    @property
    def lefts(self) -> list[Any]:
        """The left images."""
        return [pair.left.image for pair in self.pairs]

    @property
    def rights(self) -> list[Any]:
        """The right images."""
        return [pair.right.image for pair in self.pairs]


@dataclass(frozen=True, slots=True)
class Shown:
    """What a take needs to know of a sequence: its description, and the record ``fringed``'s keys for it."""

    pattern: Mapping[str, Any]
    metadata: Mapping[str, str]
