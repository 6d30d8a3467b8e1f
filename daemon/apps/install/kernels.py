"""Compilation of the kernels ahead of the service's first start, as the service's user."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

from daemon.apps.install.environment import OWN
from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import CACHE, KERNELS, STATE, USER
from daemon.apps.install.target import Target
from daemon.common.files import source_files
from daemon.kernels import cache

_TIMEOUT_S = 3600
_PROGRAM = """
import sys
from daemon.cli.allocator import prepare
from daemon.kernels.release import select
prepare()
select()
from daemon.kernels.jobs import ENCODINGS, later_jobs, measuring_jobs, rendering_jobs
from daemon.kernels.processes import compile_kernels
modes = sys.argv[1:] or [None]
measuring = [job for encoding in ENCODINGS for mode in modes for job in measuring_jobs(encoding, mode)]
compile_kernels([*rendering_jobs(ENCODINGS), *measuring, *later_jobs()])
"""


def compile_ahead(target: Target, modes: Sequence[str] = ()) -> None:
    """Compile with the installed environment; as root, with the service's user.

    Args:
        modes: multi-frame modes, in addition to the single shot.
    """
    python = target.prefix / "env/bin/python"
    user: dict[str, object] = {}
    if os.geteuid() == 0:
        ids = target.number("passwd", USER), target.number("group", USER)
        user = {"user": ids[0], "group": ids[1], "extra_groups": []}
    environment = {
        "PATH": os.environ.get("PATH", "/usr/bin:/bin"),
        "HOME": str(STATE),
        "XDG_CACHE_HOME": str(CACHE.parent),
        "NUMBA_CACHE_DIR": str(KERNELS),
    }
    process = subprocess.run(
        [str(python), "-P", "-c", _PROGRAM, *modes], env=environment, cwd="/", stdin=subprocess.DEVNULL,
        capture_output=True, text=True, timeout=_TIMEOUT_S, check=False, umask=0o027, **user,
    )  # type: ignore[call-overload]  # fmt: skip
    if process.returncode:
        raise InstallError(f"the compilation of the kernels failed:\n{process.stderr.strip()[-2000:]}")


def copy_compiled(target: Target) -> int:
    """Copy the running program's compiled kernels of the same sources; returns the number of files.

    numba compares the content of each source before it uses a file, so an outdated one is compiled again.
    """
    from numba.core import caching

    # numba below 0.62 has the name with an underscore.
    locator = getattr(caching, "UserProvidedCacheLocator", None) or caching._UserProvidedCacheLocator
    root, count = Path(__file__).resolve().parents[3], 0
    (own,) = target.path(target.prefix / "env").glob("lib/python3.*/site-packages")
    own = Path("/") / own.relative_to(target.root)
    for package in OWN:
        for folder in sorted({path.parent for path in source_files(root / package)}):
            for cached in (folder / "__pycache__").glob("*.nb[ic]"):
                sub = locator.get_suitable_cache_subpath(str(own / folder.relative_to(root) / "any.py"))
                destination = target.path(KERNELS) / sub
                destination.mkdir(parents=True, exist_ok=True)
                shutil.copy2(cached, destination)
                count += 1
    if (mark := cache.folder() / cache.MARK).is_file():
        shutil.copy2(mark, target.path(KERNELS))
    assign_to_service(target)
    return count


def assign_to_service(target: Target) -> None:
    """Give the cache to the service's user."""
    if os.geteuid() != 0:
        return
    user, group = target.number("passwd", USER), target.number("group", USER)
    for path in (target.path(KERNELS), *target.path(KERNELS).rglob("*")):
        os.chown(path, user, group, follow_symlinks=False)
