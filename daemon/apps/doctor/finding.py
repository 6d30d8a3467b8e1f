"""A finding of a check: one line and its remedy."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

Level = Literal["ok", "note", "warning", "problem"]
LEVELS: tuple[Level, ...] = ("ok", "note", "warning", "problem")


@dataclass(frozen=True, slots=True)
class Finding:
    """One line of the report.

    Args:
        area: of the check, ``disk``; name: of the checked thing, ``free space``.
        level: ``ok``; ``note``: information, or not needed; ``warning``: works with restrictions; ``problem``:
            measuring will fail.
        text: the state; remedy: a command or a setting, never empty for warnings and problems.
    """

    area: str
    name: str
    level: Level
    text: str
    remedy: str = ""

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise ValueError(f"level {self.level!r} of {self.area}/{self.name}: expected one of {', '.join(LEVELS)}")
        if not (self.area and self.name and self.text):
            raise ValueError(f"a finding requires area, name and text: {self}")
        if self.level in ("warning", "problem") and not self.remedy:
            raise ValueError(f"{self.area}/{self.name}: a {self.level} requires a remedy")


@dataclass(frozen=True, slots=True)
class Area:
    """Creates the findings of one area."""

    name: str

    def ok(self, name: str, text: str) -> Finding:
        """A finding without a problem."""
        return Finding(self.name, name, "ok", text)

    def note(self, name: str, text: str, remedy: str = "") -> Finding:
        """A finding for information."""
        return Finding(self.name, name, "note", text, remedy)

    def warning(self, name: str, text: str, remedy: str) -> Finding:
        """A finding that restricts the rig."""
        return Finding(self.name, name, "warning", text, remedy)

    def problem(self, name: str, text: str, remedy: str) -> Finding:
        """A finding that prevents measuring."""
        return Finding(self.name, name, "problem", text, remedy)

    def graded(self, name: str, text: str, remedy: str, *, certain: bool) -> Finding:
        """A problem if the rig certainly needs the checked thing, else a warning."""
        return (self.problem if certain else self.warning)(name, text, remedy)


def exit_code(findings: Iterable[Finding]) -> int:
    """1 if a finding is a problem, else 0."""
    return int(any(finding.level == "problem" for finding in findings))


def counts(findings: Iterable[Finding]) -> dict[Level, int]:
    """The number of findings of each level."""
    levels = [finding.level for finding in findings]
    return {level: levels.count(level) for level in LEVELS}
