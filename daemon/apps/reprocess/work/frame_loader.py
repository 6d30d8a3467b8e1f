"""The images of planned items, each chunk of a file read once."""

from __future__ import annotations

from collections import OrderedDict

from daemon.apps.replay.take_items import TakeItem
from daemon.apps.reprocess.plan.chunk_plan import PlannedItem
from daemon.apps.reprocess.plan.take_heads import Place
from daemon.recording.format.errors import TakeError
from daemon.recording.read.take_reader import TakePair, TakeReader
from drivers.protocols import Frame

_KEPT_CHUNKS = 4


class DamagedFramesError(TakeError):
    """Frames whose heads are whole and whose images cannot be read; ``places`` lists them."""

    def __init__(self, places: list[Place]) -> None:
        self.places = places
        super().__init__(f"{len(places)} frames are damaged, first in part {places[0][0]} at byte {places[0][1]}")


class FrameLoader:
    """Reads the items of one take."""

    def __init__(self, take: TakeReader) -> None:
        self._take = take
        self._locations = [{one.offset: one for one in part.index.data} for part in take.parts]
        self._chunks: OrderedDict[tuple[int, int], dict[int, Frame]] = OrderedDict()

    def item(self, planned: PlannedItem) -> TakeItem:
        """The images of an item.

        Raises:
            DamagedFramesError: frames that a replay does not see, or pairs that it does not form.
            TakeError: the images of a set have different encodings.
        """
        lefts, rights = ([self._frame(place) for place in side] for side in (planned.lefts, planned.rights))
        damaged: list[Place] = []
        pairs: list[tuple[Frame, Frame]] = []
        for left, right, left_at, right_at in zip(lefts, rights, planned.lefts, planned.rights, strict=True):
            if left is None or right is None:
                damaged += [place for place, frame in ((left_at, left), (right_at, right)) if frame is None]
            elif left.encoding != right.encoding:
                damaged += [left_at, right_at]
            else:
                pairs.append((left, right))
        if damaged:
            raise DamagedFramesError(damaged)
        encoding = pairs[0][0].encoding
        if any(left.encoding != encoding for left, _ in pairs):
            raise TakeError(f"{self._take.path}: the images of set {planned.sequence} have different encodings")
        newest = TakePair(planned.sequence, pairs[-1][0].image, pairs[-1][1].image, planned.t_ns, encoding)
        return TakeItem(newest, [left.image for left, _ in pairs], [right.image for _, right in pairs])

    def _frame(self, place: Place) -> Frame | None:
        number, chunk, offset = place
        if (number, chunk) not in self._chunks:
            self._chunks[number, chunk] = self._read(number, chunk)
            if len(self._chunks) > _KEPT_CHUNKS:
                self._chunks.popitem(last=False)
        return self._chunks[number, chunk].get(offset)

    def _read(self, number: int, chunk: int) -> dict[int, Frame]:
        if number >= len(self._locations) or chunk not in self._locations[number]:
            raise TakeError(f"{self._take.path}: changed since it was planned: no chunk at byte {chunk}; run again")
        frames = self._take.parts[number].frames_in(self._locations[number][chunk])
        return {where.offset: frame for frame, where in frames}
