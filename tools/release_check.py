"""What must hold of a release: one version everywhere, and an installed wheel that compiles nothing."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tomllib
import venv
from collections.abc import Iterable, Sequence
from pathlib import Path

_PROGRAM = """
import sys
from daemon.kernels import release
level, *jobs = sys.argv[1:]
assert level in release.levels(), f"this processor cannot run {level}"
release.levels = lambda: [level]
release.select()
from numba.core import event
import pipeline.reconstruct.reconstructor  # as a replay has it; numba makes its folders
from daemon.kernels.jobs import run_job
from daemon.kernels.processes import compile_kernels
with event.install_recorder("numba:compile") as recorder:
    compile_kernels(jobs)
    for job in jobs:
        run_job(job)
import daemon
print(len(recorder.buffer), daemon.__file__)
"""


def check_versions(root: Path) -> str:
    """The version of both distributions, of what they require of each other, of the citation and of the changelog.

    Raises:
        ValueError: they differ; the message has all of them by their places.
    """
    client, rig = (
        tomllib.loads((root / folder / "pyproject.toml").read_text())["project"] for folder in ("", "distributions/rig")
    )
    (extra,) = client["optional-dependencies"]["cli"]
    (required,) = (entry for entry in rig["dependencies"] if re.match(r"fringed\b", entry))
    found = {
        "pyproject.toml": client["version"],
        "pyproject.toml, extra cli": extra.removeprefix("fringed-rig=="),
        "distributions/rig/pyproject.toml": rig["version"],
        "distributions/rig/pyproject.toml, dependency fringed": required.removeprefix("fringed=="),
        "CITATION.cff": _first(r"^version: (\S+)", root / "CITATION.cff"),
        "CHANGELOG.md, first section": _first(r"^## (\S+)", root / "CHANGELOG.md"),
    }
    if len(set(found.values())) > 1:
        raise ValueError(f"versions differ: {'; '.join(f'{place}: {name}' for place, name in found.items())}")
    return str(found["CITATION.cff"])


def _first(pattern: str, path: Path) -> str:
    match = re.search(pattern, path.read_text(encoding="utf-8"), re.MULTILINE)
    return match.group(1) if match else "none"


def new_environment(folder: Path, wheels: Iterable[Path], options: Sequence[str]) -> Path:
    """Make an environment with these wheels; returns its Python.

    Args:
        options: of ``pip install``.
    """
    venv.create(folder, with_pip=False, symlinks=True)
    python = folder / "bin/python"
    pip = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, *options, *map(str, wheels)], check=True)
    return python


def compilations(python: Path, folder: Path, level: str, jobs: Iterable[str]) -> tuple[int, str]:
    """Number of functions that jobs compile in an environment with an empty cache, and what was logged.

    Args:
        python: of the environment, which lies in the folder; level: of x86-64, whose kernels are used.
    """
    plain = {key: value for key, value in os.environ.items() if not key.startswith(("PYTHON", "NUMBA"))}
    done = subprocess.run(
        [python, "-P", "-c", _PROGRAM, level, *jobs], env=plain | {"XDG_CACHE_HOME": str(folder / "cache")},
        cwd=folder, capture_output=True, text=True, timeout=600, check=False,
    )  # fmt: skip
    if done.returncode:
        raise RuntimeError(f"{level}: the jobs failed in {folder}:\n{done.stderr}")
    count, _, place = done.stdout.strip().partition(" ")
    if not Path(place).is_relative_to(folder):
        raise RuntimeError(f"{level}: the jobs did not run from the wheel but from {place}")
    return int(count), done.stderr
