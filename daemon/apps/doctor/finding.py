"""What a check found: one line, and what to do about it."""

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
        area: what was looked at, ``disk``; name: of the single thing in it, ``free space``.
        level: ``ok``; ``note``: no judgement, not there or not needed; ``warning``: works, but worse than it could;
            ``problem``: measuring will fail.
        text: what is the case; remedy: a command or a setting, never empty for warnings and problems.
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
            raise ValueError(f"a finding needs area, name and text: {self}")
        if self.level in ("warning", "problem") and not self.remedy:
            raise ValueError(f"{self.area}/{self.name}: a {self.level} needs a remedy")


@dataclass(frozen=True, slots=True)
class Area:
    """Makes the findings of one area."""

    name: str

    def ok(self, name: str, text: str) -> Finding:
        """All is well."""
        return Finding(self.name, name, "ok", text)

    def note(self, name: str, text: str, remedy: str = "") -> Finding:
        """Worth knowing."""
        return Finding(self.name, name, "note", text, remedy)

    def warning(self, name: str, text: str, remedy: str) -> Finding:
        """It works, but worse than it could."""
        return Finding(self.name, name, "warning", text, remedy)

    def problem(self, name: str, text: str, remedy: str) -> Finding:
        """Measuring will fail."""
        return Finding(self.name, name, "problem", text, remedy)

    def trouble(self, name: str, text: str, remedy: str, *, certain: bool) -> Finding:
        """A problem where it is certain that the rig needs this, else a warning."""
        return (self.problem if certain else self.warning)(name, text, remedy)


def exit_code(findings: Iterable[Finding]) -> int:
    """0 when nothing is a problem, else 1."""
    return int(any(finding.level == "problem" for finding in findings))


def counts(findings: Iterable[Finding]) -> dict[Level, int]:
    """How many there are of each level."""
    found = list(findings)
    return {level: sum(finding.level == level for finding in found) for level in LEVELS}
