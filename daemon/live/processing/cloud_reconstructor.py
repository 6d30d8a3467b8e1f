"""What the worker needs of a reconstructor: of the single shot, or of image sets."""

from __future__ import annotations

from typing import Any, Protocol

from pipeline.reconstruct.cloud import Cloud


class CloudReconstructor(Protocol):
    """Makes clouds: of pairs in mode ``single``, of image sets in the other modes."""

    @property
    def mode(self) -> str:
        """The mode whose images it reconstructs."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras, a sentence each."""

    def warm_up(self, *, strides: tuple[int, ...], use_prior: bool) -> None:
        """Compile every kernel for these strides, and for the use of a prior."""

    def reconstruct(self, left: Any, right: Any, /, *, stride: int = 1, use_prior: bool = False) -> Cloud:
        """The cloud of two raw images, or of the two lists of a set's images.

        Args:
            stride: spacing of the pixels that are measured; use_prior: the last pair's orders are a good guess.
        """

    def color(self, left: Any, /) -> Any:
        """The fringe-free colour of the left raw image, or of a set's left images, (H, W, 3) uint8."""
