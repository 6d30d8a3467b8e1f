"""Reading small files without trusting their size."""

from __future__ import annotations

from pathlib import Path


def read_at_most(path: Path, limit: int, error: type[Exception]) -> bytes:
    """The bytes of a file of at most ``limit`` bytes; ``error`` is raised, naming the file, for anything else."""
    try:
        with Path(path).open("rb") as file:
            data = file.read(limit + 1)
    except OSError as problem:
        raise error(f"{path}: {problem.strerror or problem}") from problem
    if len(data) > limit:
        raise error(f"{path}: larger than {limit} bytes; this is not the file that is expected here")
    return data
