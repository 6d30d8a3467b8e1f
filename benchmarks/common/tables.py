"""A table that can be printed on a terminal, put into a Markdown file, and kept as JSON."""

from __future__ import annotations

import json
import os
import statistics
import tempfile
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.table import Table as RichTable


@dataclass(slots=True)
class Table:
    """Rows of text under headings; the first column and those in ``text_columns`` are text, the others figures.

    Args:
        name: key in the file of results; title: above the table; headings: one per column.
        rows: as long as the headings; notes: sentences below the table.
    """

    name: str
    title: str
    headings: Sequence[str]
    rows: list[Sequence[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    text_columns: Sequence[str] = ()

    def add(self, *cells: str) -> None:
        """One more row."""
        if len(cells) != len(self.headings):
            raise ValueError(f"a row of table {self.name} has {len(cells)} cells, expected {len(self.headings)}")
        self.rows.append(cells)

    def is_text(self, column: int) -> bool:
        """Whether a column is aligned to the left."""
        return column == 0 or self.headings[column] in self.text_columns

    def print(self, console: Console) -> None:
        """Show the table and its notes on a terminal."""
        table = RichTable(title=self.title, title_justify="left")
        for i, heading in enumerate(self.headings):
            table.add_column(heading, justify="left" if self.is_text(i) else "right")
        for row in self.rows:
            table.add_row(*row)
        console.print(table)
        for note in self.notes:
            console.print(note, highlight=False)

    def markdown(self) -> str:
        """The same as Markdown."""
        rules = ["---" if self.is_text(i) else "--:" for i in range(len(self.headings))]
        lines = [f"### {self.title}", "", _row(self.headings), _row(rules), *map(_row, self.rows)]
        for note in self.notes:
            lines += ["", note]
        return "\n".join(lines)


def _row(cells: Iterable[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def median_and_worst(values: Sequence[float]) -> tuple[str, str]:
    """Median and largest value with one decimal."""
    return f"{statistics.median(values):.1f}", f"{max(values):.1f}"


def as_json(tables: Sequence[Table], machine: dict[str, str], figures: dict[str, Any]) -> str:
    """Everything that was measured; the figures hold plain numbers, the tables what was printed."""
    return json.dumps({"machine": machine, "figures": figures, "tables": [asdict(t) for t in tables]}, indent=1)


def write_whole(path: Path, content: str | bytes) -> None:
    """Write a file atomically."""
    path.parent.mkdir(parents=True, exist_ok=True)
    data = content.encode() if isinstance(content, str) else content
    handle, fresh = tempfile.mkstemp(prefix=f".{path.name}-", dir=path.parent)
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        Path(fresh).chmod(0o644)
        Path(fresh).replace(path)
    except BaseException:
        Path(fresh).unlink(missing_ok=True)
        raise


def with_block(text: str, name: str, block: str) -> str:
    """A document in which the block between the two marks of a name is replaced."""
    begin, end = marks(name)
    if text.count(begin) != 1 or text.count(end) != 1 or text.index(begin) > text.index(end):
        raise ValueError(f"the document needs one line {begin!r} and after it one line {end!r}")
    return f"{text.split(begin)[0]}{begin}\n\n{block.strip()}\n\n{end}{text.split(end)[1]}"


def marks(name: str) -> tuple[str, str]:
    """The lines before and after a measured block."""
    return f"<!-- measured: {name} (make bench writes this block) -->", f"<!-- end of {name} -->"
