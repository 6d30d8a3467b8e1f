"""The contents of a take and whether it is whole: every image is read and its checksum verified."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

from daemon.recording.format.part_names import CALIBRATION, PATTERN, RIG, VOLUME
from daemon.recording.read.part_reader import PartReader
from daemon.recording.read.take_reader import Counts, TakeReader
from drivers.protocols import SIDES, TRIGGER_MODULUS, Frame, Side
from pipeline.common.errors import PipelineError

_MAX_GAPS = 8


@dataclass(slots=True)
class _Tally(Counts):
    """Totals over the frames of a take."""

    images: Counter[str] = field(default_factory=Counter)
    numbers: set[int] = field(default_factory=set)
    times_ns: list[int] = field(default_factory=list)
    last: int | None = None

    def part(self, frames: dict[Side, set[int]]) -> None:
        """Count the pairs of a finished part: both frames of a pair lie in the same one."""
        left, right = frames["left"], frames["right"]
        self.pairs += len(left & right)
        self.unpaired["left"] += len(left - right)
        self.unpaired["right"] += len(right - left)

    def frame(self, frame: Frame, triggers: dict[Side, set[int]]) -> None:
        """Add a frame."""
        self.frames[frame.side] += 1
        height, width = frame.image.shape[:2]
        self.images[f"{frame.side} {frame.encoding} {width} x {height}"] += 1
        self.last = unwrapped(frame.trigger, self.last)
        if frame.trigger in triggers[frame.side]:
            self.duplicates[frame.side] += 1
            return
        triggers[frame.side].add(frame.trigger)
        if self.last not in self.numbers:
            self.numbers.add(self.last)
            self.times_ns.append(frame.t_exposure_ns)


def unwrapped(number: int, last: int | None) -> int:
    """Return a trigger number without the wrap at 2**32: the one nearest to the number before."""
    if last is None:
        return number
    step = (number - last + TRIGGER_MODULUS // 2) % TRIGGER_MODULUS - TRIGGER_MODULUS // 2
    return last + step


def gaps(numbers: set[int]) -> list[tuple[int, int]]:
    """Return first and last missing number of every gap, as trigger numbers modulo 2**32."""
    missing = [(a + 1, b - 1) for a, b in pairwise(sorted(numbers)) if b > a + 1]
    return [(first % TRIGGER_MODULUS, last % TRIGGER_MODULUS) for first, last in missing]


def inspect(take: TakeReader, progress: Callable[[int], Any] | None = None) -> dict[str, Any]:
    """Read a take and return its report as plain values.

    Args:
        progress: called with the number of bytes read so far.
    """
    tally, done = _Tally(), 0
    for part in take.parts:
        triggers: dict[Side, set[int]] = {side: set() for side in SIDES}
        for frame, location in part.frames():
            tally.frame(frame, triggers)
            if progress is not None:
                progress(done + location.chunk.offset)
        tally.part(triggers)
        done += part.index.size
    files = [_file(part) for part in take.parts]
    return {
        "take": str(take.path),
        "whole": take.whole,
        "problems": take.problems,
        "truncated_at": take.truncated_at,
        "parts": files,
        "bytes": take.size,
        **{key: take.metadata.get(key) for key in ("version", "session", "device")},
        **_sums(tally),
        **_attached(take),
    }


def _file(part: PartReader) -> dict[str, Any]:
    return {"file": str(part.path), "bytes": part.index.size, "readable_to": part.index.readable_to}


def _sums(tally: _Tally) -> dict[str, Any]:
    missing = gaps(tally.numbers)
    seconds = (max(tally.times_ns) - min(tally.times_ns)) / 1e9 if tally.times_ns else 0.0
    steps = len(tally.times_ns) - 1
    return {
        "pairs": tally.pairs,
        "frames": {side: tally.frames[side] for side in SIDES},
        "unpaired": {side: tally.unpaired[side] for side in SIDES},
        "duplicates": {side: tally.duplicates[side] for side in SIDES},
        "pictures": dict(sorted(tally.images.items())),
        "first_sequence": min(tally.numbers) % TRIGGER_MODULUS if tally.numbers else None,
        "last_sequence": max(tally.numbers) % TRIGGER_MODULUS if tally.numbers else None,
        "missing": sum((last - first) % TRIGGER_MODULUS + 1 for first, last in missing),
        "gaps": [list(gap) for gap in missing[:_MAX_GAPS]],
        "start_ns": min(tally.times_ns, default=None),
        "duration_s": round(seconds, 6),
        "rate_hz": round(steps / seconds, 3) if seconds > 0 else None,
    }


def _attached(take: TakeReader) -> dict[str, Any]:
    """Describe the attachments; one that cannot be used is listed among the problems, not raised."""
    out: dict[str, Any] = {"attachments": {name: len(data) for name, data in take.attachments.items()}}
    problems: list[str] = []
    for name, read in ((CALIBRATION, _calibration), (PATTERN, _pattern), (VOLUME, _volume)):
        if name not in take.attachments:
            problems.append(f"{take.path}: {name} is not attached")
            continue
        try:
            out |= read(take)
        except PipelineError as error:
            problems.append(str(error))
    out["has_rig"] = RIG in take.attachments
    out["attachment_problems"] = problems
    return out


def _calibration(take: TakeReader) -> dict[str, Any]:
    file = take.calibration()
    return {"calibration": file.identity, "baseline_mm": round(file.calibration.baseline_mm, 3)}


def _pattern(take: TakeReader) -> dict[str, Any]:
    sequence = take.sequence()
    if sequence is not None:
        values = {"sequence": sequence.name, "frames": len(sequence), "size": list(sequence.size)}
        return {"pattern": values | {"first_pattern_sequence": take.first_pattern_sequence}}
    pattern = take.pattern()
    fringe = "frequency-modulated" if pattern.profile is not None else "plain"
    return {"pattern": {"size": list(pattern.size), "periods": pattern.periods, "axis": pattern.axis, "fringe": fringe}}


def _volume(take: TakeReader) -> dict[str, Any]:
    volume = take.volume()
    return {"volume": {"near_mm": volume.near_mm, "far_mm": volume.far_mm}}
