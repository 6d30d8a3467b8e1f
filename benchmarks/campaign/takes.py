"""The takes of a campaign, each read to its end: wrong pairs, and what is missing at a cut end."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from daemon.recording.format.errors import TakeError
from daemon.recording.format.part_names import PARTIAL
from daemon.recording.read.take_reader import TakeReader
from sim.box.exposure_ledger import Ledger, Trigger

_ENDING = re.compile(r"(_part\d+)?\.mcap(\.partial)?$")


@dataclass(slots=True)
class Takes:
    """Counts: takes, those cut off, unreadable ones; pairs by class.

    ``unknown``: pairs with a frame whose trigger is not remembered any more, or never was.
    """

    takes: int = 0
    cut: int = 0
    unreadable: int = 0
    right: int = 0
    wrong: int = 0
    unknown: int = 0
    problems: tuple[str, ...] = ()

    def read(self, directory: Path, ledger: Ledger, *, writing: str = "") -> None:
        """Check every take of a directory and delete it, but for the one that is being written."""
        files = sorted(directory.glob("*.mcap*")) if directory.is_dir() else []
        for stem in sorted({stem_of(file) for file in files}):
            if stem != writing:
                self._read_one(first_part(directory, stem), ledger)
                for file in files:
                    if stem_of(file) == stem:
                        file.unlink(missing_ok=True)

    def _read_one(self, path: Path, ledger: Ledger) -> None:
        self.takes += 1
        try:
            with TakeReader(path) as reader:
                for pair in reader.pairs():
                    self._count(
                        path, pair.sequence, *(ledger.exposure_of(s, getattr(pair, s)) for s in ("left", "right"))
                    )
                self.cut += bool(reader.problems)
        except TakeError as error:
            if path.stat().st_size == 0:
                self.cut += 1  # killed before the first byte
            else:
                self.unreadable += 1
                self.problems += (f"{path.name}: {error}",)

    def _count(self, path: Path, sequence: int, left: Trigger | None, right: Trigger | None) -> None:
        if left is None or right is None:
            self.unknown += 1
        elif left.index == right.index:
            self.right += 1
        else:
            self.wrong += 1
            self.problems += (f"{path.name}: pair {sequence} is of triggers {left.index} and {right.index}",)


def stem_of(file: Path) -> str:
    """What all files of a take have in common."""
    return _ENDING.sub("", file.name)


def first_part(directory: Path, stem: str) -> Path:
    """The first file of a take, finished or not."""
    path = directory / f"{stem}.mcap"
    return path if path.exists() else path.with_name(path.name + PARTIAL)


def last_shown(path: Path, ledger: Ledger) -> Trigger | None:
    """The newest trigger of which a take holds the left frame."""
    newest: Trigger | None = None
    with TakeReader(path) as reader:
        for pair in reader.pairs():
            shown = ledger.exposure_of("left", pair.left)
            if shown is not None and (newest is None or shown.index > newest.index):
                newest = shown
    return newest
