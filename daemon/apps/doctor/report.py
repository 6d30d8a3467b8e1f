"""The findings as text and as JSON."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from daemon.apps.doctor.finding import Finding, Level, counts, exit_code

WIDTH = 110
MARKS: dict[Level, str] = {"ok": "ok", "note": "-", "warning": "warning", "problem": "PROBLEM"}
COLOURS: dict[Level, str] = {"ok": "green", "note": "bright_black", "warning": "yellow", "problem": "red"}

Line = tuple[str, str, Level, str]
"""Area, mark, level and text of a printed line; the first two are empty in continuation lines."""

_AREA, _MARK = 12, 9

SKIPPED = "not needed", "needs a rig.yaml"
"""Names of the findings of areas that were not checked; the text combines them in one line."""


def skipped(findings: Sequence[Finding]) -> list[Finding]:
    """One finding for each reason, with all areas that were not checked for it."""
    reasons: dict[str, list[str]] = {}
    for finding in findings:
        if finding.name in SKIPPED:
            reasons.setdefault(finding.text, []).append(finding.area)
    return [Finding("left out", "areas", "note", f"{reason}: {', '.join(areas)}") for reason, areas in reasons.items()]


def lines(findings: Sequence[Finding]) -> Iterator[Line]:
    """The lines of one area: each finding, with its remedy below it."""
    area = findings[0].area if findings else ""
    for finding in findings:
        for i, text in enumerate(_wrapped(finding.text)):
            yield area, "" if i else MARKS[finding.level], finding.level, text
            area = ""
        for i, text in enumerate(_wrapped(finding.remedy, 3) if finding.remedy else ()):
            yield "", "", finding.level, ("   " if i else "-> ") + text


def columns(line: Line) -> tuple[str, str, str]:
    """Area and mark padded to their columns, and the text."""
    area, mark, _, text = line
    return area.ljust(_AREA), mark.ljust(_MARK), text


def verdict(findings: Sequence[Finding]) -> str:
    """The summary line."""
    number = counts(findings)
    if not number["problem"] and not number["warning"]:
        return "no problems, no warnings"
    return f"{_count(number['problem'], 'problem')}, {_count(number['warning'], 'warning')}"


def as_json(findings: Sequence[Finding], rig: Path | None) -> dict[str, Any]:
    """The whole report as plain values."""
    return {
        "rig": str(rig) if rig is not None else None,
        "healthy": exit_code(findings) == 0,
        "counts": dict(counts(findings)),
        "findings": [asdict(finding) for finding in findings],
    }


def _wrapped(text: str, indent: int = 0) -> list[str]:
    width = WIDTH - _AREA - _MARK - indent
    # Commands stay intact: lines break only at spaces.
    return textwrap.wrap(" ".join(text.split()), width, break_long_words=False, break_on_hyphens=False) or [""]


def _count(number: int, noun: str) -> str:
    return f"{number or 'no'} {noun}{'' if number == 1 else 's'}"
