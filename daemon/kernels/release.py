"""Compiled kernels of a release: chosen by Python and processor at the start, unpacked before the first use.

numba finds them since the environment names the level that they were compiled for and the folder of the user's cache
that they are unpacked to. Nothing is done in a checkout, which has none, nor where the user names a processor.
"""

from __future__ import annotations

import hashlib
import logging
import os
import platform
import sys
from pathlib import Path

FOLDER = Path(__file__).with_name("compiled")
"""Where a release has its archives."""

_V3 = {
    "abm", "avx", "avx2", "bmi1", "bmi2", "cx16", "f16c", "fma", "lahf_lm", "movbe", "pni", "popcnt", "sse4_1",
    "sse4_2", "ssse3", "xsave",
}  # fmt: skip
_V4 = _V3 | {"avx512bw", "avx512cd", "avx512dq", "avx512f", "avx512vl"}
LEVELS = {"x86-64-v4": _V4, "x86-64-v3": _V3}
"""Flags in /proc/cpuinfo of every processor of a level, the highest first (x86-64 psABI; pni is SSE3, abm LZCNT)."""

log = logging.getLogger("fringed")


def levels(cpuinfo: Path = Path("/proc/cpuinfo")) -> list[str]:
    """Levels whose code all processors of this machine can run, the highest first."""
    if platform.machine() != "x86_64":
        return []
    try:
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
    flags = [set(line.partition(":")[2].split()) for line in lines if line.startswith("flags")]
    return [name for name, needed in LEVELS.items() if flags and all(needed <= each for each in flags)]


def select() -> None:
    """Let numba use the suitable kernels of this release, if any; call it before numba is imported."""
    if "NUMBA_CPU_NAME" in os.environ or (description := _suitable()) is None:
        return
    given, user = os.environ.get("NUMBA_CACHE_DIR"), os.environ.get("XDG_CACHE_HOME")
    base = Path(given) if given else (Path(user) if user else Path.home() / ".cache") / "fringed" / "kernels"
    os.environ["NUMBA_CPU_NAME"] = description.stem.partition("-")[2]
    os.environ["NUMBA_CPU_FEATURES"] = ""
    os.environ["NUMBA_CACHE_DIR"] = str(base / _folder_name(description))


def unpack() -> None:
    """Unpack the selected kernels unless that is done; a reason against it is logged, and they are compiled."""
    from daemon.kernels import cache

    description = _suitable()
    if description is None or cache.folder().name != _folder_name(description):
        return
    if (cache.folder() / cache.MARK).exists():
        return
    from daemon.kernels.archive import ArchiveError, unpack

    try:
        cache.folder().parent.mkdir(parents=True, exist_ok=True)
        unpack(description, cache.folder())
    except (ArchiveError, OSError) as error:
        log.warning("the kernels of the release are not used, they are compiled here: %s", error)


def _suitable() -> Path | None:
    """Description of the archive for this Python and the highest level."""
    python = f"cp{sys.version_info.major}{sys.version_info.minor}"
    files = (FOLDER / f"{python}-{level}.json" for level in levels()) if FOLDER.is_dir() else ()
    return next((path for path in files if path.is_file()), None)


def _folder_name(description: Path) -> str:
    """Name of the folder: it differs for other kernels, and for another place of the sources."""
    digest = hashlib.sha256(description.read_bytes() + os.fsencode(description))
    return f"{description.stem}-{digest.hexdigest()[:16]}"
