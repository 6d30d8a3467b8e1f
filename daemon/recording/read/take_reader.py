"""Read a take: its frames and pairs, in bounded memory, up to whatever damage there is."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

from daemon.recording.format import part_names as parts
from daemon.recording.format.errors import TakeError
from daemon.recording.format.part_names import CALIBRATION, PATTERN, VOLUME
from daemon.recording.format.raw_image import Pixels
from daemon.recording.read.part_reader import PartReader, Where
from daemon.rig.calibration_file import CalibrationFile, parse_calibration
from daemon.rig.pattern_file import parse_pattern, parse_sequence, parse_volume
from drivers.protocols import TRIGGER_MODULUS, Frame, Side
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.sequence import Sequence
from pipeline.rig.volume import Volume

WAITING_FRAMES = 16
"""Frames that are kept in memory while their partner has not come; older ones are read again when it does."""


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
    """What has been read so far."""

    frames: Counter[str] = field(default_factory=Counter)
    pairs: int = 0
    unpaired: Counter[str] = field(default_factory=Counter)
    duplicates: Counter[str] = field(default_factory=Counter)


class TakeReader:
    """A take: one file, or all the parts of it if the first part is named.

    Cut and damaged files are read as far as they can be; :attr:`problems` tells what is wrong with them. The counts in
    :attr:`counts` are those of the last walk through :meth:`frames` or :meth:`pairs`.

    Raises:
        TakeError: a file that is no recording, or that holds something else than pairs of raw images.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._parts: list[PartReader] = []
        self._lost_parts: list[str] = []
        try:
            first, *later = parts.of_take(path)
            self._parts.append(PartReader(first))
            for part in later:
                self._add_part(part)
        except BaseException:
            self.close()
            raise
        self.counts = Counts()

    def __enter__(self) -> TakeReader:
        return self

    def __exit__(self, _: type[BaseException] | None, __: BaseException | None, ___: TracebackType | None) -> None:
        self.close()

    def _add_part(self, path: Path) -> None:
        """Take a further file for a part, unless it is of another take; one that cannot be read is told."""
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
        """What is wrong, file by file; complete once everything was read."""
        found = [f"{part.path}: {problem}" for part in self._parts for problem in part.problems]
        return found + self._lost_parts

    @property
    def whole(self) -> bool:
        """Whether nothing is missing or damaged, as far as it was read."""
        return not self.problems

    @property
    def size(self) -> int:
        """Bytes of all parts."""
        return sum(part.survey.size for part in self._parts)

    def calibration(self) -> CalibrationFile:
        """The attached calibration; TakeError when there is none, CalibrationError when it is wrong."""
        return parse_calibration(*self._attached(CALIBRATION))

    def pattern(self) -> ColorFringe:
        """The attached pattern description."""
        return parse_pattern(*self._attached(PATTERN))

    def sequence(self) -> Sequence | None:
        """The attached sequence of a take whose images differ, None for a take of a single pattern."""
        return parse_sequence(*self._attached(PATTERN))

    @property
    def first_pattern_sequence(self) -> int:
        """Number of a trigger that shows the first image of the sequence; TakeError for what is no number."""
        text = self.metadata.get("first_pattern_sequence", "0")
        if not (text.isascii() and text.isdecimal() and len(text) <= 10 and int(text) < TRIGGER_MODULUS):
            raise TakeError(f"{self.path}: first_pattern_sequence is {text!r:.40}, expected a trigger number")
        return int(text)

    def volume(self) -> Volume:
        """The attached measuring volume."""
        return parse_volume(*self._attached(VOLUME))

    def _attached(self, name: str) -> tuple[bytes, str]:
        data = self.attachments.get(name)
        if data is None:
            there = ", ".join(self.attachments) or "nothing"
            raise TakeError(f"{self.path}: no readable attachment {name}; attached is {there}")
        return data, f"{self.path}:{name}"

    @property
    def summary(self) -> Counts:
        """The counts of the last walk."""
        return self.counts

    @property
    def truncated_at(self) -> int | None:
        """First byte that is lost, of the first part that has no end; None for a take whose parts all have one."""
        return next((part.survey.readable_to for part in self._parts if not part.survey.whole), None)

    def frames(self, progress: Callable[[int], Any] | None = None) -> Iterator[Frame]:
        """Every frame in the order of the files, double ones and lone ones included.

        Args:
            progress: told the number of bytes read so far.
        """
        self.counts = Counts()
        for frame, _ in self._walk(progress):
            yield frame

    def pairs(self, progress: Callable[[int], Any] | None = None) -> Iterator[TakePair]:
        """Every pair, as soon as its second frame is read; left and right may come in any order.

        A second frame of the same number and side is counted and ignored; so are frames without a partner.
        """
        self.counts = Counts()
        for part, done in self._parts_done():
            matcher = _Matcher(part, self.counts)
            for frame, where in part.frames():
                self.counts.frames[frame.side] += 1
                if progress is not None:
                    progress(done + where.place.offset)
                pair = matcher.match(frame, where)
                if pair is not None:
                    yield pair
            matcher.finish()

    def _parts_done(self) -> Iterator[tuple[PartReader, int]]:
        done = 0
        for part in self._parts:
            yield part, done
            done += part.survey.size

    def _walk(self, progress: Callable[[int], Any] | None) -> Iterator[tuple[Frame, Where]]:
        for part, done in self._parts_done():
            for frame, where in part.frames():
                self.counts.frames[frame.side] += 1
                if progress is not None:
                    progress(done + where.place.offset)
                yield frame, where


class _Matcher:
    """Brings frames of one part together by number, with few of them in memory."""

    def __init__(self, part: PartReader, counts: Counts) -> None:
        self._part, self._counts = part, counts
        self._seen: dict[Side, set[int]] = {"left": set(), "right": set()}
        self._waiting: OrderedDict[tuple[Side, int], Where] = OrderedDict()
        self._held: OrderedDict[tuple[Side, int], Frame] = OrderedDict()

    def match(self, frame: Frame, where: Where) -> TakePair | None:
        """The pair that this frame completes."""
        if frame.trigger in self._seen[frame.side]:
            self._counts.duplicates[frame.side] += 1
            return None
        self._seen[frame.side].add(frame.trigger)
        other: Side = "right" if frame.side == "left" else "left"
        key = (other, frame.trigger)
        if key not in self._waiting:
            self._wait(frame, where)
            return None
        partner = self._held.pop(key, None) or self._part.frame_at(self._waiting[key])
        del self._waiting[key]
        if partner is None:
            self._counts.unpaired[frame.side] += 1
            return None
        left, right = (frame, partner) if frame.side == "left" else (partner, frame)
        if left.encoding != right.encoding:
            self._part.complain(f"pair {left.trigger}: {left.encoding} on the left, {right.encoding} on the right")
            self._counts.unpaired.update(("left", "right"))
            return None
        self._counts.pairs += 1
        return TakePair(left.trigger, left.image, right.image, left.t_exposure_ns, left.encoding)

    def _wait(self, frame: Frame, where: Where) -> None:
        key = (frame.side, frame.trigger)
        self._waiting[key] = where
        self._held[key] = frame
        if len(self._held) > WAITING_FRAMES:
            self._held.popitem(last=False)

    def finish(self) -> None:
        """No more frames: those that still wait have no partner."""
        for side, _ in self._waiting:
            self._counts.unpaired[side] += 1
