"""The chunks of a take: which pairs or sets each one holds, and which frames those need."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from daemon.apps.replay.take_items import Sets, TakeItem, pairs_of
from daemon.apps.reprocess.plan.take_heads import Place, TakeHeads
from daemon.live.processing.temporal_prior import TemporalPrior
from daemon.recording.format.part_names import CALIBRATION, PATTERN, VOLUME


@dataclass(frozen=True, slots=True)
class PlannedItem:
    """A pair, or a complete set, and the places of its images.

    Args:
        sequence, t_ns: number and exposure of its first pair.
        lefts, rights: one place for each frame of the sequence.
        write: False where a later item of the take has the same number, whose file replaces this one's.
    """

    sequence: int
    t_ns: int
    lefts: tuple[Place, ...]
    rights: tuple[Place, ...]
    write: bool = True


@dataclass(frozen=True, slots=True)
class Chunk:
    """Consecutive items; ``first``: position of its first possible frame in the take, its name."""

    first: int
    items: tuple[PlannedItem, ...]

    @property
    def name(self) -> str:
        """Of its manifest."""
        return f"chunk_{self.first:09d}"

    def source(self) -> str:
        """Hash of numbers, times and places of its frames."""
        rows = [(item.sequence, item.t_ns, item.lefts, item.rights, item.write) for item in self.items]
        return hashlib.sha256(json.dumps(rows).encode()).hexdigest()


@dataclass(slots=True)
class TakePlan:
    """What a take holds, without its images.

    Args:
        attachments: SHA-256 of the attached calibration, pattern and volume by name.
        mode: name of the sequence, ``single`` for pairs; frames: images of each camera per item.
        pairs, bytes: of the take; incomplete: sets that miss a pair; damaged: frames that were excluded.
    """

    metadata: dict[str, str]
    attachments: dict[str, str]
    bytes: int
    mode: str
    frames: int
    pairs: int
    incomplete: int
    unpaired: dict[str, int]
    duplicates: dict[str, int]
    damaged: int
    problems: list[str] = field(default_factory=list)
    chunks: list[Chunk] = field(default_factory=list)

    @property
    def items(self) -> int:
        """Pairs or sets to be reconstructed."""
        return sum(len(chunk.items) for chunk in self.chunks)


def plan_take(
    path: Path, *, chunk_pairs: int, use_prior: bool = False, fuse: bool = False, excluded: Collection[Place] = ()
) -> TakePlan:
    """Read indexes and heads of a take, and divide its items.

    Args:
        chunk_pairs: pairs of images in a chunk; the same division results after frames were excluded.
        use_prior: divide only where no pair can use the one before as temporal prior.
        fuse: one chunk, as every cloud is averaged with those before.

    Raises:
        TakeError: not a readable take; PipelineError: attachments that cannot be used.
    """
    with closing(TakeHeads(path, excluded)) as take:
        sequence = take.sequence()
        sets = None if sequence is None else Sets(take, sequence)
        items = list(_last_of_each_number([_planned(item) for item in (sets.items() if sets else pairs_of(take))]))
        ends = [take.ordinals[max(item.lefts + item.rights)] for item in items]
        if fuse:
            chunks = [Chunk(0, tuple(items))] if items else []
        elif use_prior and sets is None:
            chunks = _between_gaps(items, ends)
        else:
            chunks = _by_position(items, ends, 2 * chunk_pairs)
        return TakePlan(
            dict(take.metadata),
            {name: hashlib.sha256(take.attachments.get(name, b"")).hexdigest() for name in _USED},
            take.size, "single" if sequence is None else sequence.name, 1 if sequence is None else len(sequence),
            take.counts.pairs, 0 if sets is None else sets.incomplete, dict(+take.counts.unpaired),
            dict(+take.counts.duplicates), len(excluded), take.problems, chunks,
        )  # fmt: skip


_USED = (CALIBRATION, PATTERN, VOLUME)


def _planned(item: TakeItem) -> PlannedItem:
    lefts: Any = item.lefts
    rights: Any = item.rights
    return PlannedItem(item.pair.sequence, item.pair.t_ns, tuple(lefts), tuple(rights))


def _last_of_each_number(items: Sequence[PlannedItem]) -> Iterator[PlannedItem]:
    """A number that comes again after a restart of the counter: only the last cloud of it is kept, as in a replay."""
    left = Counter(item.sequence for item in items)
    for item in items:
        left[item.sequence] -= 1
        if left[item.sequence]:
            yield PlannedItem(item.sequence, item.t_ns, item.lefts, item.rights, write=False)
        else:
            yield item


def _by_position(items: Sequence[PlannedItem], ends: Sequence[int], frames: int) -> list[Chunk]:
    """One chunk for every ``frames`` frames of the take.

    The first item is a chunk of its own where there are several: it gives the column correction for all others.
    """
    groups: dict[int, list[PlannedItem]] = {}
    for item, end in zip(items, ends, strict=True):
        groups.setdefault(end // frames, []).append(item)
    chunks = [Chunk(number * frames, tuple(group)) for number, group in groups.items()]
    if len(chunks) > 1 and len(chunks[0].items) > 1:
        head = chunks[0]
        chunks[:1] = [Chunk(head.first, head.items[:1]), Chunk(head.first + 1, head.items[1:])]
    return chunks


def _between_gaps(items: Sequence[PlannedItem], ends: Sequence[int]) -> list[Chunk]:
    chunks: list[tuple[int, list[PlannedItem]]] = []
    prior = TemporalPrior()
    for item, end in zip(items, ends, strict=True):
        if not chunks or not prior.usable(item.sequence, item.t_ns, 1):
            chunks.append((end - end % 2, []))
        chunks[-1][1].append(item)
        prior.measured(item.sequence, item.t_ns, 1)
    return [Chunk(first, tuple(group)) for first, group in chunks]
