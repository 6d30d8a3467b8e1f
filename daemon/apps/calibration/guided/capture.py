"""Images of a sequence as the cameras gave them, and who can take them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from daemon.recording.format.raw_image import Pixels
from pipeline.pattern.sequence import FrameSequence

Progress = Callable[[int, int], None]


def unheard(done: int, of: int) -> None:
    """Progress that nobody wants to hear of."""


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """One pair of raw images a frame of a sequence.

    Args:
        encoding: as of :class:`drivers.protocols.Frame`.
        pairs: left and right, (H, W) or (H, W, 3), uint8 or uint16.
    """

    encoding: str
    pairs: tuple[tuple[Pixels, Pixels], ...]

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """(width, height) of each camera's images."""
        left, right = self.pairs[0]
        return {"left": (left.shape[1], left.shape[0]), "right": (right.shape[1], right.shape[0])}


class Shooter(Protocol):
    """Shows images on the projector and takes pairs that surely show them."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the projector, pixels."""

    def shoot(self, sequence: FrameSequence, *, progress: Progress = unheard) -> Shots:
        """A pair for each frame.

        Args:
            progress: told (done, of).

        Raises:
            DriverError, DaemonError: no pairs came, or the projector failed; it may be tried again.
        """

    @property
    def notes(self) -> tuple[str, ...]:
        """What the person should know, in sentences."""

    @property
    def has_hand(self) -> bool:
        """Whether a simulated hand holds the board, not a person."""

    def next_pose(self) -> bool:
        """Let the simulated hand move the board on; False once it has shown all its poses, or where there is none."""

    def close(self) -> None:
        """Let go of everything; the last image does not stay."""
