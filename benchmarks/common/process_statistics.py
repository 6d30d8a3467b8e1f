"""Statistics of a running process: memory, processor time by thread, open files."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

_TICK_S = 1 / os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Sample:
    """A process at one moment.

    Args:
        t_s: monotonic; rss_mib: everything resident, mapped files too; own_mib: private memory, the part that grows
            by a leak; cpu_s: processor time by name of thread, threads of one name together.
    """

    t_s: float
    rss_mib: float
    own_mib: float
    threads: int
    files: int
    cpu_s: dict[str, float]


def sample(pid: int, now_s: float) -> Sample:
    """The process now; OSError when it has ended."""
    root = Path("/proc") / str(pid)
    lines = (line.split() for line in (root / "status").read_text().splitlines())
    fields = {parts[0].rstrip(":"): parts[1] for parts in lines if len(parts) > 1}
    return Sample(
        t_s=now_s,
        rss_mib=int(fields["VmRSS"]) / 1024,
        own_mib=int(fields["RssAnon"]) / 1024,
        threads=int(fields["Threads"]),
        files=len(list((root / "fd").iterdir())),
        cpu_s=_by_name(root / "task"),
    )


def _by_name(tasks: Path) -> dict[str, float]:
    spent: dict[str, float] = {}
    for task in tasks.iterdir():
        try:
            text = (task / "stat").read_text()
        except OSError:
            continue  # the thread has just ended
        # The name stands in brackets and may hold anything, brackets too.
        name, _, rest = text.partition("(")[2].rpartition(")")
        fields = rest.split()
        spent[name] = spent.get(name, 0.0) + _TICK_S * (int(fields[11]) + int(fields[12]))
    return spent
