"""The items of a take to reconstruct: pairs, or complete sets of a multi-frame mode."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from daemon.live.acquisition.set_assembler import SetAssembler
from daemon.recording.format.errors import TakeError
from daemon.recording.read.take_reader import TakePair, TakeReader
from pipeline.pattern.sequence import FrameSequence


@dataclass(frozen=True, slots=True, eq=False)
class TakeItem:
    """The images of one cloud.

    Args:
        pair: for display: the newest images, with number and time of the first ones.
        lefts, rights: raw images, one each in the mode single.
    """

    pair: TakePair
    lefts: list[Any]
    rights: list[Any]


def pairs_of(take: TakeReader, progress: Callable[[int], Any] | None = None) -> Iterator[TakeItem]:
    """Every pair as an item."""
    for pair in take.pairs(progress):
        yield TakeItem(pair, [pair.left], [pair.right])


class Sets:
    """The complete sets of a take; ``incomplete`` counts the others."""

    def __init__(self, take: TakeReader, sequence: FrameSequence) -> None:
        self._take, self._frames = take, len(sequence)
        self.incomplete = 0

    def items(self, progress: Callable[[int], Any] | None = None) -> Iterator[TakeItem]:
        """Yield the sets in the order of the take.

        Raises:
            TakeError: images of two encodings.
        """
        assembler: SetAssembler[TakePair] = SetAssembler(self._frames, self._take.first_pattern_sequence)
        for pair in self._take.pairs(progress):
            image_set = assembler.feed(pair.sequence, pair.t_ns, pair)
            self.incomplete = assembler.incomplete
            if image_set is not None:
                yield _item(image_set, self._take)
        assembler.flush()
        self.incomplete = assembler.incomplete


def _item(pairs: tuple[TakePair, ...], take: TakeReader) -> TakeItem:
    first, last = pairs[0], pairs[-1]
    if any(pair.encoding != first.encoding for pair in pairs):
        raise TakeError(f"{take.path}: the images of set {first.sequence} have different encodings")
    newest = TakePair(first.sequence, last.left, last.right, first.t_ns, first.encoding)
    return TakeItem(newest, [pair.left for pair in pairs], [pair.right for pair in pairs])
