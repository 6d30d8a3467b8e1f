"""Views of a board in a recorded take."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import MOST_IMAGES
from daemon.apps.calibration.views.view import Progress, View, described_sequence
from daemon.recording.read.take_reader import TakePair, TakeReader

_NUMBERS = 1 << 32
PATTERN = "pattern.json"


class TakeSource:
    """A take: every ``len(frames)`` triggers from ``first_pattern_sequence`` on are one view.

    A take without a sequence holds one view a pair. Views with a frame that was lost are left out and told in
    :attr:`left_out`.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._path = path
        self.left_out: list[str] = []
        with TakeReader(path) as take:
            described = take.attachments.get(PATTERN)
            first = take.metadata.get("first_pattern_sequence", "0")
        try:
            data = None if described is None else json.loads(described)
            self._first = int(first)
        except (ValueError, RecursionError) as error:
            raise SourceError(f"{path}: {PATTERN} or first_pattern_sequence: {error}") from error
        self.sequence = described_sequence(data, f"{path}:{PATTERN}")

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Every view of which all frames are there."""
        count = len(self.sequence) if self.sequence is not None else 1
        self.left_out.clear()
        group: dict[int, TakePair] = {}
        number, views = -1, 0
        with TakeReader(self._path) as take:
            for pair in take.pairs(lambda done: progress(done, take.size)):
                place = (pair.sequence - self._first) % _NUMBERS
                if place // count != number:
                    yield from self._finished(group, number, count, only)
                    group, number, views = {}, place // count, views + 1
                if views > MOST_IMAGES:
                    raise SourceError(f"{self.name}: more than {MOST_IMAGES} views; record the board at rest only")
                if only is None or place % count == only:
                    group[place % count] = pair
            yield from self._finished(group, number, count, only)
            progress(take.size, take.size)

    def _finished(self, group: dict[int, TakePair], number: int, count: int, only: int | None) -> Iterator[View]:
        if number < 0:
            return
        wanted = range(count) if only is None else (only,)
        lost = [frame for frame in wanted if frame not in group]
        name = f"view_{number:02d}"
        if lost:
            self.left_out.append(f"{name}: frame {lost[0]} of its sequence was lost ({len(lost)} in all)")
            return
        pairs = [group[frame] for frame in wanted]
        files = tuple(f"{self.name}, trigger {pairs[0].sequence}, {side}" for side in ("left", "right"))
        left, right = tuple(pair.left for pair in pairs), tuple(pair.right for pair in pairs)
        yield View(name, (files[0], files[1]), left, right, pairs[0].encoding)
