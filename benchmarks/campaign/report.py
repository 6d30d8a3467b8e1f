"""The table of a campaign."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, field
from statistics import median
from typing import Any

from benchmarks.campaign.takes import Takes


@dataclass(frozen=True, slots=True)
class Outcome:
    """One fault.

    Args:
        recovery_s: from the fault's end to the second cloud after it, None if there was none in time.
        lost: triggers from its beginning to the recovery that gave no cloud.
    """

    name: str
    survived: bool
    lost: int
    recovery_s: float | None


@dataclass(slots=True)
class Campaign:
    """All results; ``missing_s``: of each take cut by a kill, the time from its last pair to the kill."""

    outcomes: list[Outcome] = field(default_factory=list)
    takes: Takes = field(default_factory=Takes)
    missing_s: list[float] = field(default_factory=list)
    memory_mib: list[float] = field(default_factory=list)
    triggers: int = 0
    clouds: int = 0
    seconds: float = 0.0

    def problems(self) -> list[str]:
        """Reasons why it has failed."""
        found = [f"not survived: {outcome.name}" for outcome in self.outcomes if not outcome.survived]
        found += [f"{self.takes.wrong} wrong pairs in takes"] if self.takes.wrong else []
        found += [f"{self.takes.unreadable} takes cannot be read"] if self.takes.unreadable else []
        found += [*self.takes.problems[:10]]
        if self.missing_s and max(self.missing_s) > 2.0:
            found.append(f"{max(self.missing_s):.1f} s are missing at the end of a take whose daemon was killed")
        return found

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self) | {"problems": self.problems()}

    def markdown(self) -> str:
        """The table and the text below it."""
        rows = [
            "| fault | tried | survived | triggers without a cloud, median / most | recovery s, median / longest |",
            "| --- | --- | --- | --- | --- |",
        ]
        for name in dict.fromkeys(sorted(outcome.name for outcome in self.outcomes)):
            rows.append(_row(name, [outcome for outcome in self.outcomes if outcome.name == name]))
        takes = self.takes
        survived = sum(outcome.survived for outcome in self.outcomes)
        rows += [
            "",
            f"{len(self.outcomes)} faults of {len({o.name for o in self.outcomes})} kinds, {survived} survived, in "
            f"{self.seconds / 60:.0f} minutes; {self.triggers} triggers, {self.clouds} clouds. "
            f"{takes.takes} takes ({takes.cut} cut off), {takes.unreadable} unreadable; {takes.right} pairs right, "
            f"{takes.wrong} wrong, {takes.unknown} unknown.",
        ]
        if self.missing_s:
            rows.append(
                f"After a kill {median(self.missing_s):.2f} s (median), at most {max(self.missing_s):.2f} s of the "
                f"take were missing ({len(self.missing_s)} kills)."
            )
        if self.memory_mib:
            rows.append(f"Memory of the daemon and its processes: {self.memory_mib[0]:.0f} MiB first, "
                        f"{self.memory_mib[-1]:.0f} MiB last, {max(self.memory_mib):.0f} MiB at most.")  # fmt: skip
        return "\n".join(rows)


def _row(name: str, outcomes: Iterable[Outcome]) -> str:
    outcomes = list(outcomes)
    times = [outcome.recovery_s for outcome in outcomes if outcome.recovery_s is not None]
    lost = [outcome.lost for outcome in outcomes]
    recovery = f"{median(times):.2f} / {max(times):.2f}" if times else "never"
    survived = sum(outcome.survived for outcome in outcomes)
    return f"| {name} | {len(outcomes)} | {survived} | {median(lost):.0f} / {max(lost)} | {recovery} |"
