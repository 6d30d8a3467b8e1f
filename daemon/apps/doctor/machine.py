"""The machine's state from /proc, /sys, /dev and /etc under a root that tests replace, and from the environment."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

MAX_BYTES = 1 << 18
MAX_ENTRIES = 4096


@dataclass(frozen=True, slots=True)
class Program:
    """A running program: its process id, its short name, its command line."""

    pid: int
    name: str
    command: str

    def __str__(self) -> str:
        return f"{self.name} (process {self.pid})"

    @property
    def is_daemon(self) -> bool:
        """Whether the command line is that of a daemon of this project."""
        return "fringed" in self.command and " run" in self.command


@dataclass(frozen=True, slots=True)
class Machine:
    """Access to the machine's files.

    Args:
        root: directory of proc, sys, dev and etc; environ: the environment.
    """

    root: Path = Path("/")
    environ: Mapping[str, str] = field(default_factory=lambda: dict(os.environ))

    def path(self, name: str) -> Path:
        """The file of an absolute name such as ``/proc/meminfo``."""
        return self.root / name.lstrip("/")

    def text(self, name: str | Path) -> str:
        """The content of a file, stripped; empty if it is missing or unreadable."""
        try:
            with (self.path(name) if isinstance(name, str) else name).open("rb") as file:
                return file.read(MAX_BYTES).decode(errors="replace").strip()
        except OSError:
            return ""

    def number(self, name: str | Path) -> int | None:
        """The integer in a file, None without one."""
        try:
            return int(self.text(name))
        except ValueError:
            return None

    def entries(self, pattern: str) -> list[Path]:
        """The files below the root that match a pattern, sorted, at most 4096."""
        try:
            paths = sorted(self.root.glob(pattern.lstrip("/")))
        except OSError:
            return []
        return paths[:MAX_ENTRIES]

    def programs(self) -> Iterator[Program]:
        """Every running program that has a name."""
        for directory in self.entries("/proc/[0-9]*"):
            name = self.text(directory / "comm")
            if name and directory.name.isdigit():
                yield Program(int(directory.name), name, self.text(directory / "cmdline").replace("\0", " ").strip())

    def program(self, pid: int) -> Program | None:
        """The program of a process id, None if it has ended or is hidden."""
        name = self.text(f"/proc/{pid}/comm")
        command = self.text(f"/proc/{pid}/cmdline").replace("\0", " ").strip()
        return Program(pid, name, command) if name else None

    def may_use(self, path: Path) -> bool:
        """Whether this user can read and write a file."""
        return os.access(path, os.R_OK | os.W_OK)
