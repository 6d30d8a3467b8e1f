"""Pages of the documentation: fenced blocks and links."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"

_NOT_RUN = re.compile(r"<!-- not run: (.+) -->")
_FENCE = re.compile(r"( *)```([\w-]*)\s*$")
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_HEADING = re.compile(r"#+ +(.+?) *$")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block.

    Args:
        page: its file; line: of the opening fence, from 1.
        language: after the fence, empty without one.
        text: the lines in between.
        comment: the HTML comment in the line above the fence, such as ``run``; empty without one.
    """

    page: Path
    line: int
    language: str
    text: str
    comment: str

    @property
    def name(self) -> str:
        """The page and line, for a test."""
        return f"{self.page.relative_to(ROOT)}:{self.line}"

    @property
    def reason(self) -> str:
        """The stated reason for which it is not run, else empty."""
        found = _NOT_RUN.fullmatch(self.comment)
        return found[1] if found else ""


def pages() -> list[Path]:
    """Every page, README.md first."""
    return [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]


def blocks(page: Path) -> Iterator[Block]:
    """Every fenced block of a page.

    Raises:
        ValueError: a fence without an end.
    """
    lines = page.read_text(encoding="utf-8").splitlines()
    number = 0
    while number < len(lines):
        opening = _FENCE.match(lines[number])
        number += 1
        if opening is None:
            continue
        begin, indent = number, opening[1]
        while number < len(lines) and lines[number].rstrip() != f"{indent}```":
            number += 1
        if number == len(lines):
            raise ValueError(f"{page}:{begin}: the block has no closing fence")
        text = "\n".join(line.removeprefix(indent) for line in lines[begin:number])
        above = lines[begin - 2].strip() if begin > 1 else ""
        yield Block(page, begin, opening[2], text, above if above.startswith("<!--") else "")
        number += 1


def _prose(page: Path) -> Iterator[tuple[int, str]]:
    """Number and text of every line outside of fenced blocks."""
    inside = False
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1):
        if line.lstrip().startswith("```"):
            inside = not inside
        if not inside:
            yield number, line


def links(page: Path) -> Iterator[tuple[int, str]]:
    """Line and target of every link and image outside code."""
    for number, line in _prose(page):
        for found in _LINK.finditer(re.sub(r"`[^`]*`", "", line)):
            yield number, found[1]


def spans(page: Path) -> Iterator[tuple[int, str]]:
    """Line and text of every piece of code within the text of a page, outside of fenced blocks."""
    for number, line in _prose(page):
        for found in re.finditer(r"`([^`]+)`", line):
            yield number, found[1]


def anchors(page: Path) -> set[str]:
    """The anchors of the page's headings, as mkdocs (and GitHub, for plain headings) forms them."""
    found = set()
    for line in page.read_text(encoding="utf-8").splitlines():
        if heading := _HEADING.match(line):
            text = re.sub(r"[^\w\s-]", "", heading[1].replace("`", "")).strip().lower()
            found.add(re.sub(r"[-\s]+", "-", text))
    return found
