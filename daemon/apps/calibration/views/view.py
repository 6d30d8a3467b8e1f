"""A view of a calibration board, and the protocol of its sources."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import Image
from daemon.rig.camera_serials import Serials
from pipeline.common.errors import PatternError
from pipeline.pattern import sequence as sequences
from pipeline.pattern.projected_frames import Uniform
from pipeline.pattern.sequence import FrameSequence

Progress = Callable[[int, int], None]


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """One pose of the board: an image of each camera, or one for every frame of a sequence.

    Args:
        name: short, for tables: ``view_03`` or ``left03.jpg``.
        files: names of the left and the right images in messages.
        left, right: raw images in ``encoding``; one of them may be empty (one camera only).
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
        serials: of the cameras, where they are known.
        left_out: views that the last iteration left out, each with its reason.
    """

    serials: Serials
    name: str
    sequence: FrameSequence | None
    left_out: list[str]

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Yield every view; of a sequence all frames, or only frame ``only``."""
        ...


def described_sequence(data: Any, name: str) -> FrameSequence | None:
    """The sequence of a pattern description; None for the description of a single pattern, or for none."""
    if not isinstance(data, Mapping) or data.get("kind") != "sequence":
        return None
    try:
        return sequences.from_mapping(data)
    except PatternError as error:
        raise SourceError(f"{name}: {error}") from error


def white_frame(sequence: FrameSequence | None) -> int:
    """Number of the brightest uniform frame, on which marks are detected; 0 without a sequence."""
    if sequence is None:
        return 0
    uniform = [(sum(f.color), -n) for n, f in enumerate(sequence.frames) if isinstance(f, Uniform)]
    if not uniform or max(uniform)[0] == 0:
        raise SourceError(
            f"sequence {sequence.name}: it has no uniform frame with light, which the detection of marks requires"
        )
    return -max(uniform)[1]
