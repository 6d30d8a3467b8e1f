"""Views of a board in a recorded take."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from daemon.apps.calibration.errors import SourceError
from daemon.apps.calibration.images.image_files import MOST_IMAGES
from daemon.apps.calibration.views.view import Progress, View, described_sequence
from daemon.recording.read.take_reader import TakePair, TakeReader
from daemon.rig.camera_serials import Serials, serials_of_take

_NUMBERS = 1 << 32
PATTERN = "pattern.json"


class TakeSource:
    """A take: every ``len(frames)`` triggers from ``first_pattern_sequence`` on are one view.

    In a take without a sequence every pair is a view. Views with a lost frame are listed in :attr:`left_out`.
    """

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self._path = path
        self.left_out: list[str] = []
        with TakeReader(path) as take:
            description = take.attachments.get(PATTERN)
            first = take.metadata.get("first_pattern_sequence", "0")
            self.serials: Serials = serials_of_take(take.metadata)
        try:
            data = None if description is None else json.loads(description)
            self._first = int(first)
        except (ValueError, RecursionError) as error:
            raise SourceError(f"{path}: {PATTERN} or first_pattern_sequence: {error}") from error
        self.sequence = described_sequence(data, f"{path}:{PATTERN}")

    def views(self, progress: Progress, *, only: int | None = None) -> Iterator[View]:
        """Yield every complete view."""
        count = len(self.sequence) if self.sequence is not None else 1
        self.left_out.clear()
        group: dict[int, TakePair] = {}
        number, views = -1, 0
        with TakeReader(self._path) as take:
            for pair in take.pairs(lambda position: progress(position, take.size)):
                offset = (pair.sequence - self._first) % _NUMBERS
                if offset // count != number:
                    yield from self._complete(group, number, count, only)
                    group, number, views = {}, offset // count, views + 1
                if views > MOST_IMAGES:
                    raise SourceError(
                        f"{self.name}: more than {MOST_IMAGES} views; record only while the board is at rest"
                    )
                if only is None or offset % count == only:
                    group[offset % count] = pair
            yield from self._complete(group, number, count, only)
            progress(take.size, take.size)

    def _complete(self, group: dict[int, TakePair], number: int, count: int, only: int | None) -> Iterator[View]:
        if number < 0:
            return
        frames = range(count) if only is None else (only,)
        lost = [frame for frame in frames if frame not in group]
        name = f"view_{number:02d}"
        if lost:
            self.left_out.append(f"{name}: frame {lost[0]} of its sequence was lost ({len(lost)} in total)")
            return
        pairs = [group[frame] for frame in frames]
        files = tuple(f"{self.name}, trigger {pairs[0].sequence}, {side}" for side in ("left", "right"))
        left, right = tuple(pair.left for pair in pairs), tuple(pair.right for pair in pairs)
        yield View(name, (files[0], files[1]), left, right, pairs[0].encoding)
