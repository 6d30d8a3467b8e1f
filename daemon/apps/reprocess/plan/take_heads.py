"""A take read without its images: pairs and sets are found by the same code as in a replay, from message heads."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Any

from daemon.recording.read.part_reader import FrameLocation, PartReader
from daemon.recording.read.take_reader import TakeReader
from drivers.protocols import Frame

Place = tuple[int, int, int]
"""Of a frame: number of the part, byte of its chunk, byte of the message inside."""


class TakeHeads(TakeReader):
    """A take of which only indexes, attachments and message heads are read.

    Its pairs have the places of their frames instead of images.

    Args:
        excluded: places of frames that turned out to be damaged: a replay never sees them.

    ``ordinals`` gives the position of each place among all frames of the take, excluded ones included.
    """

    def __init__(self, path: Path, excluded: Collection[Place] = ()) -> None:
        super().__init__(path)
        self._excluded = frozenset(excluded)
        self.ordinals: dict[Place, int] = {}

    def _walk(self, progress: Callable[[int], Any] | None) -> Iterator[Any]:  # noqa: ARG002 - heads are read quickly
        for number, part in enumerate(self.parts):
            heads = _HeadPart(part)
            for frame, where in part.heads():
                place = number, where.chunk.offset, where.offset
                self.ordinals[place] = len(self.ordinals)
                if place in self._excluded:
                    continue
                self.counts.frames[frame.side] += 1
                yield heads, heads.add(frame, where, place), where


class _HeadPart:
    """What the pairing of frames asks a file for."""

    def __init__(self, part: PartReader) -> None:
        self._heads: dict[FrameLocation, Frame] = {}
        self.add_problem, self.frame_at = part.add_problem, self._heads.get

    def add(self, frame: Frame, where: FrameLocation, place: Any) -> Frame:
        """Keep a frame with its place instead of an image."""
        head = Frame(frame.side, frame.trigger, frame.t_exposure_ns, frame.t_host_ns, "", place)
        self._heads[where] = head
        return head
