"""Reading a take: its frames and pairs, in bounded memory, also from cut and damaged files."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from daemon.recording.format.errors import TakeError
from daemon.recording.format.part_names import CALIBRATION, PATTERN, VOLUME, files_of_take
from daemon.recording.format.raw_image import Pixels
from daemon.recording.read.part_reader import FrameLocation, PartReader
from daemon.rig.calibration_file import CalibrationFile, parse_calibration
from daemon.rig.pattern_file import parse_pattern, parse_sequence, parse_volume
from drivers.protocols import TRIGGER_MODULUS, Frame, Side
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.sequence import FrameSequence
from pipeline.rig.volume import Volume

WAITING_FRAMES = 16
"""Unpaired frames kept in memory; older ones are read again when their partner comes."""


@dataclass(frozen=True, slots=True, eq=False)
class TakePair:
    """Two raw images of one exposure.

    Args:
        sequence: number of the trigger; t_ns: start of exposure of the left camera.
        left, right: (H, W) or (H, W, 3), uint8 or uint16, read-only, both in ``encoding``.
    """

    sequence: int
    left: Pixels
    right: Pixels
    t_ns: int
    encoding: str


@dataclass(slots=True)
class Counts:
    """Counts of the frames read so far."""

    frames: Counter[str] = field(default_factory=Counter)
    pairs: int = 0
    unpaired: Counter[str] = field(default_factory=Counter)
    duplicates: Counter[str] = field(default_factory=Counter)


class TakeReader:
    """A take: one file, or all the parts of it if the first part is named.

    Cut and damaged files are read as far as possible; :attr:`problems` lists the damage. The counts in :attr:`counts`
    are those of the last iteration over :meth:`frames` or :meth:`pairs`.

    Raises:
        TakeError: a file that is not a take, or that holds something else than pairs of raw images.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts: list[PartReader] = []
        self._lost_parts: list[str] = []
        try:
            first, *later = files_of_take(path)
            self._parts.append(PartReader(first))
            for part in later:
                self._add_part(part)
        except BaseException:
            self.close()
            raise
        self.counts = Counts()

    def __enter__(self) -> TakeReader:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _add_part(self, path: Path) -> None:
        """Add a further file, unless it is of another take; one that cannot be read is listed as a problem."""
        try:
            part = PartReader(path)
        except TakeError as error:
            self._lost_parts.append(str(error))
            return
        sessions = self.metadata.get("session"), part.metadata.get("session")
        if None not in sessions and sessions[0] != sessions[1]:
            part.close()
        else:
            self._parts.append(part)

    def close(self) -> None:
        """Close the files; images that were handed out stay valid."""
        for part in self._parts:
            part.close()

    @property
    def parts(self) -> list[PartReader]:
        """The files of the take."""
        return self._parts

    @property
    def metadata(self) -> dict[str, str]:
        """The record ``fringed``: version, session, device."""
        return self._parts[0].metadata

    @property
    def attachments(self) -> dict[str, bytes]:
        """The attached files by name."""
        return self._parts[0].attachments

    @property
    def problems(self) -> list[str]:
        """Problems file by file; complete once everything was read."""
        return [f"{part.path}: {problem}" for part in self._parts for problem in part.problems] + self._lost_parts

    @property
    def whole(self) -> bool:
        """Whether nothing is missing or damaged, as far as it was read."""
        return not self.problems

    @property
    def size(self) -> int:
        """Bytes of all parts."""
        return sum(part.index.size for part in self._parts)

    def calibration(self) -> CalibrationFile:
        """Parse the attached calibration; TakeError when there is none, CalibrationError when it is invalid."""
        return parse_calibration(*self._attached(CALIBRATION))

    def pattern(self) -> ColorFringe:
        """Parse the attached pattern description."""
        return parse_pattern(*self._attached(PATTERN))

    def sequence(self) -> FrameSequence | None:
        """Parse the attached sequence of a take whose images differ; None for a take of a single pattern."""
        return parse_sequence(*self._attached(PATTERN))

    @property
    def first_pattern_sequence(self) -> int:
        """Number of a trigger that shows the first image of the sequence; TakeError if it is not a number."""
        text = self.metadata.get("first_pattern_sequence", "0")
        if not (text.isascii() and text.isdecimal() and len(text) <= 10 and int(text) < TRIGGER_MODULUS):
            raise TakeError(f"{self.path}: first_pattern_sequence is {text!r:.40}, expected a trigger number")
        return int(text)

    def volume(self) -> Volume:
        """Parse the attached measuring volume."""
        return parse_volume(*self._attached(VOLUME))

    def _attached(self, name: str) -> tuple[bytes, str]:
        data = self.attachments.get(name)
        if data is None:
            attached = ", ".join(self.attachments) or "nothing"
            raise TakeError(f"{self.path}: no readable attachment {name}; attached is {attached}")
        return data, f"{self.path}:{name}"

    @property
    def truncated_at(self) -> int | None:
        """First lost byte of the first part that has no end; None for a take whose parts all have one."""
        return next((part.index.readable_to for part in self._parts if not part.index.whole), None)

    def frames(self, progress: Callable[[int], Any] | None = None) -> Iterator[Frame]:
        """Yield every frame in the order of the files, duplicate and unpaired ones included.

        Args:
            progress: called with the number of bytes read so far.
        """
        self.counts = Counts()
        for _, frame, _ in self._walk(progress):
            yield frame

    def pairs(self, progress: Callable[[int], Any] | None = None) -> Iterator[TakePair]:
        """Yield every pair as soon as its second frame is read; left and right may come in any order.

        A second frame of the same number and side is counted and ignored; so are frames without a partner.
        """
        self.counts = Counts()
        for part, frames in groupby(self._walk(progress), key=itemgetter(0)):
            matcher = _Matcher(part, self.counts)
            yield from filter(None, (matcher.match(frame, location) for _, frame, location in frames))
            matcher.finish()

    def _walk(self, progress: Callable[[int], Any] | None) -> Iterator[tuple[PartReader, Frame, FrameLocation]]:
        done = 0
        for part in self._parts:
            for frame, location in part.frames():
                self.counts.frames[frame.side] += 1
                if progress is not None:
                    progress(done + location.chunk.offset)
                yield part, frame, location
            done += part.index.size


class _Matcher:
    """Pairs the frames of one part by trigger number, with few of them in memory."""

    def __init__(self, part: PartReader, counts: Counts) -> None:
        self._part, self._counts = part, counts
        self._numbers: dict[Side, set[int]] = {"left": set(), "right": set()}
        self._waiting: OrderedDict[tuple[Side, int], FrameLocation] = OrderedDict()
        self._frames: OrderedDict[tuple[Side, int], Frame] = OrderedDict()

    def match(self, frame: Frame, location: FrameLocation) -> TakePair | None:
        """Return the pair that this frame completes, if any."""
        if frame.trigger in self._numbers[frame.side]:
            self._counts.duplicates[frame.side] += 1
            return None
        self._numbers[frame.side].add(frame.trigger)
        other: Side = "right" if frame.side == "left" else "left"
        key = (other, frame.trigger)
        if key not in self._waiting:
            self._wait(frame, location)
            return None
        partner = self._frames.pop(key, None) or self._part.frame_at(self._waiting[key])
        del self._waiting[key]
        if partner is None:
            self._counts.unpaired[frame.side] += 1
            return None
        left, right = (frame, partner) if frame.side == "left" else (partner, frame)
        if left.encoding != right.encoding:
            self._part.add_problem(f"pair {left.trigger}: {left.encoding} on the left, {right.encoding} on the right")
            self._counts.unpaired.update(("left", "right"))
            return None
        self._counts.pairs += 1
        return TakePair(left.trigger, left.image, right.image, left.t_exposure_ns, left.encoding)

    def _wait(self, frame: Frame, location: FrameLocation) -> None:
        key = (frame.side, frame.trigger)
        self._waiting[key] = location
        self._frames[key] = frame
        if len(self._frames) > WAITING_FRAMES:
            self._frames.popitem(last=False)

    def finish(self) -> None:
        """Count the frames that still wait as unpaired."""
        for side, _ in self._waiting:
            self._counts.unpaired[side] += 1
