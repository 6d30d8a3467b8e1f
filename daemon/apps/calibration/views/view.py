"""A view of a board, and the protocol of what gives views."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import Image
from pipeline.common.errors import PatternError
from pipeline.pattern import sequence as sequences
from pipeline.pattern.sequence import FrameSequence, Uniform

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One place of the board: an image of each camera, or one for every frame of a sequence.

    Args:
        name: short, for tables: ``view_03`` or ``left03.jpg``.
        files: what errors call the images of the left and the right camera.
        left, right: as the sensor gave them, in ``encoding``; one of them may be empty (only one camera was told).
        encoding: ``rgb8``, ``bayer_rggb8`` ..., ``mono8``, ``mono16``; ``rgb8`` also for 16-bit colour.
    """

    name: str
    files: tuple[str, str]
    left: tuple[Image, ...]
    right: tuple[Image, ...]
    encoding: str


class Source(Protocol):
    """An iterable source of views.

    Args:
        name: for messages. sequence: whose frames make a view, None where a view is a single pair.
        left_out: views that the last iteration left out, each with its reason.
    """

    name: str
    sequence: FrameSequence | None
    left_out: list[str]

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Every view; of a sequence all frames, or only the one of that number."""
        ...


def described_sequence(data: Any, name: str) -> FrameSequence | None:
    """The sequence of a pattern description; None for a description of a single image, or for none."""
    if not isinstance(data, Mapping) or data.get("kind") != "sequence":
        return None
    try:
        return sequences.from_mapping(data)
    except PatternError as error:
        raise SourceError(f"{name}: {error}") from error


def white_frame(sequence: FrameSequence | None) -> int:
    """Number of the brightest even frame, on which marks are found; 0 where there is no sequence."""
    if sequence is None:
        return 0
    even = [(sum(f.color), -n) for n, f in enumerate(sequence.frames) if isinstance(f, Uniform)]
    if not even or max(even)[0] == 0:
        raise SourceError(f"sequence {sequence.name}: it has no even image with light, marks cannot be found in it")
    return -max(even)[1]
