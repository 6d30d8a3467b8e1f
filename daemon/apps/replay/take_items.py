"""What a take holds to be reconstructed one after the other: pairs, or whole sets of a multi-frame mode."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from daemon.live.acquisition.set_assembler import SetAssembler
from daemon.recording.format.errors import TakeError
from daemon.recording.read.take_reader import TakePair, TakeReader
from pipeline.pattern.sequence import FrameSequence


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """The images of one cloud.

    Args:
        pair: for the eye: the newest images, with number and time of the first ones.
        lefts, rights: raw images; of a single pattern, one each.
    """

    pair: TakePair
    lefts: list[Any]
    rights: list[Any]


def pairs_of(take: TakeReader, progress: Callable[[int], Any] | None = None) -> Iterator[Shot]:
    """Every pair as a shot of its own."""
    for pair in take.pairs(progress):
        yield Shot(pair, [pair.left], [pair.right])


class Sets:
    """The whole sets of a take of a sequence; those that miss an image are counted in ``incomplete``."""

    def __init__(self, take: TakeReader, sequence: FrameSequence) -> None:
        self._take, self._frames = take, len(sequence)
        self.incomplete = 0

    def shots(self, progress: Callable[[int], Any] | None = None) -> Iterator[Shot]:
        """In the order of the take.

        Raises:
            TakeError: images of two encodings.
        """
        gatherer: SetAssembler[TakePair] = SetAssembler(self._frames, self._take.first_pattern_sequence)
        for pair in self._take.pairs(progress):
            made = gatherer.feed(pair.sequence, pair.t_ns, pair)
            self.incomplete = gatherer.incomplete
            if made is not None:
                yield _shot(made, self._take)
        gatherer.flush()
        self.incomplete = gatherer.incomplete


def _shot(made: tuple[TakePair, ...], take: TakeReader) -> Shot:
    first, last = made[0], made[-1]
    if any(pair.encoding != first.encoding for pair in made):
        raise TakeError(f"{take.path}: the images of set {first.sequence} are of different encodings")
    shown = TakePair(first.sequence, last.left, last.right, first.t_ns, first.encoding)
    return Shot(shown, [pair.left for pair in made], [pair.right for pair in made])
