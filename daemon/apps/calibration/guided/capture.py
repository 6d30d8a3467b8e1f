"""Captured raw images of a sequence, and the protocol of their capture."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from daemon.recording.format.raw_image import Pixels
from daemon.rig.camera_serials import Serials
from pipeline.pattern.sequence import FrameSequence

Progress = Callable[[int, int], None]


def no_progress(completed: int, total: int) -> None:
    """Ignore progress."""


@dataclass(frozen=True, slots=True, eq=False)
class CapturedImages:
    """One pair of raw images for each frame of a sequence.

    Args:
        encoding: as of :class:`drivers.protocols.Frame`.
        pairs: left and right, (H, W) or (H, W, 3), uint8 or uint16.
        serials: of the cameras, where they are known.
    """

    encoding: str
    pairs: tuple[tuple[Pixels, Pixels], ...]
    serials: Serials = field(default_factory=dict)

    @property
    def sizes(self) -> dict[str, tuple[int, int]]:
        """(width, height) of each camera's images."""
        left, right = self.pairs[0]
        return {"left": (left.shape[1], left.shape[0]), "right": (right.shape[1], right.shape[0])}


class ImageCapture(Protocol):
    """Projects frames and captures pairs that are confirmed to show them."""

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) of the projector, pixels."""

    def capture(self, sequence: FrameSequence, *, progress: Progress = no_progress) -> CapturedImages:
        """Capture a pair for each frame.

        Args:
            progress: called with the completed and the total number of frames.

        Raises:
            DriverError, DaemonError: no pairs arrived, or the projector failed; a retry is possible.
        """

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the user, whole sentences."""

    @property
    def has_hand(self) -> bool:
        """Whether a simulated hand, not a person, holds the board."""

    def next_pose(self) -> bool:
        """Move the board to the simulated hand's next pose; False after the last pose, or without a simulated hand."""

    def close(self) -> None:
        """Stop projecting and release all devices."""
