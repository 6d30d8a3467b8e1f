"""``fringed replay`` in this process."""

from __future__ import annotations

from pathlib import Path

from daemon.cli.entry import run


def replay(take: Path, *arguments: object) -> int:
    return run(["replay", str(take), *(str(argument) for argument in arguments)])
