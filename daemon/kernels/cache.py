"""What the cache of compiled kernels holds, and for which sources, libraries and processor.

numba compares a cached kernel with the file of its own function only: constants and functions of other files are
compiled into it, too. A mark beside the cached files names everything that they depend on.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sys
from collections.abc import Iterable
from functools import cache
from importlib.metadata import version
from pathlib import Path

from daemon.common.files import source_files, write_atomically

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = "pipeline", "sim"
"""Packages whose functions numba compiles."""
MARK = "fringed-kernels.json"


@cache
def sources_key() -> str:
    """Hash of the sources."""
    digest = hashlib.sha256()
    for package in PACKAGES:
        for path in sorted(path for path in source_files(ROOT / package) if path.suffix == ".py"):
            digest.update(str(path.relative_to(ROOT)).encode() + b"\0" + path.read_bytes())
    return digest.hexdigest()[:32]


@cache
def libraries() -> dict[str, str]:
    """Versions of Python and of the libraries that generate code; numba distinguishes minor versions of numpy."""
    return {
        "python": f"{sys.version_info.major}.{sys.version_info.minor}",
        "numba": version("numba"),
        "llvmlite": version("llvmlite"),
        "numpy": ".".join(version("numpy").split(".")[:2]),
    }


@cache
def cache_key() -> str:
    """Hash of the sources, the versions of the libraries, and the processor."""
    return hashlib.sha256(repr((sources_key(), libraries(), processor())).encode()).hexdigest()[:32]


def processor() -> tuple[str, str]:
    """What numba compiles for: architecture and, unless the environment names a level, the processor's abilities."""
    named = os.environ.get("NUMBA_CPU_NAME")
    if named:
        return platform.machine(), f"{named} {os.environ.get('NUMBA_CPU_FEATURES', '')}"
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return platform.machine(), platform.processor()
    kept = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
    return platform.machine(), hashlib.sha256("\n".join(sorted(kept)).encode()).hexdigest()


def folder() -> Path:
    """Where the mark lies: beside the cached kernels, or in the user's cache where those are with the sources."""
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return Path(given)
    own = ROOT / "pipeline" / "__pycache__"
    own.mkdir(exist_ok=True) if os.access(own.parent, os.W_OK) else None
    if os.access(own, os.W_OK):
        return own
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fringed"


def compiled_jobs() -> frozenset[str]:
    """Jobs whose kernels are in the cache for these sources and this processor."""
    try:
        mark = json.loads((folder() / MARK).read_text(encoding="utf-8"))
        return frozenset(mark["jobs"]) if mark["key"] == cache_key() else frozenset()
    except (OSError, ValueError, KeyError, TypeError):
        return frozenset()


def note_compiled(jobs: Iterable[str]) -> None:
    """Note that the kernels of jobs are in the cache; without a place to write, the next start asks numba."""
    mark = {"key": cache_key(), "jobs": sorted(compiled_jobs() | set(jobs))}
    try:
        folder().mkdir(parents=True, exist_ok=True)
        write_atomically(folder() / MARK, json.dumps(mark).encode())
    except OSError:
        return


def discard_outdated() -> int:
    """Remove kernels that were compiled from other sources; returns the number of files."""
    if compiled_jobs():
        return 0
    given = os.environ.get("NUMBA_CACHE_DIR")
    roots = [Path(given)] if given else [ROOT / package for package in PACKAGES]
    files = [path for root in roots for path in root.rglob("*.nb[ic]")]
    for path in files:
        path.unlink(missing_ok=True)
    return len(files)
