"""``python -m tools.release``: the wheels of both distributions, with compiled kernels for this Python, in ``dist/``.

The kernels are compiled for each level of x86-64 that this processor can run, for it must run them once. Archives of
other Pythons that were made from the same sources are kept: run it with each of them, the last wheel has them all.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from pathlib import Path

from daemon.kernels import cache, release
from daemon.kernels.archive import ArchiveError, pack, read_description
from daemon.kernels.jobs import release_jobs

ROOT = Path(__file__).resolve().parents[1]
ARCHIVES = "FRINGED_KERNELS"
"""Environment variable: the folder of archives that the wheel takes; see ``distributions/rig/hatch_build.py``."""


def compile_archive(level: str, folder: Path, jobs: Iterable[str]) -> Path:
    """Compile the kernels of some jobs for a level and write their archive; returns its description's path."""
    with tempfile.TemporaryDirectory(prefix="fringed-kernels-") as cached:
        environment = os.environ | {
            "NUMBA_CPU_NAME": level,
            "NUMBA_CPU_FEATURES": "",
            "NUMBA_CACHE_DIR": cached,
            "NUMBA_DISABLE_INTEL_SVML": "1",  # a library that other machines may lack
        }
        command = [sys.executable, "-P", "-m", "tools.release", "--into", str(folder), "--level", level, *jobs]
        subprocess.run(command, env=environment | {"PYTHONPATH": str(ROOT)}, check=True)
    return release_file(folder, level)


def release_file(folder: Path, level: str) -> Path:
    """The description that a compilation of this process's Python writes."""
    from daemon.kernels.archive import description_file

    return description_file(folder, level, cache.libraries()["python"])


def discard_outdated(folder: Path) -> None:
    """Remove archives of other sources."""
    for path in folder.glob("*.json"):
        try:
            kept = read_description(path).sources == cache.sources_key()
        except ArchiveError:
            kept = False
        if not kept:
            path.unlink()
            path.with_suffix(".tar.xz").unlink(missing_ok=True)


def build_wheels(out: Path, archives: Path | None, options: Sequence[str] = ()) -> list[Path]:
    """Build the wheels of both distributions, the rig's with the archives of a folder."""
    environment = dict(os.environ)
    environment.pop(ARCHIVES, None)
    if archives is not None:
        environment[ARCHIVES] = str(archives.resolve())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps", *options]
    subprocess.run(
        [*pip, "--wheel-dir", str(out), str(ROOT), str(ROOT / "distributions/rig")], env=environment, check=True
    )
    return sorted(out.glob("fringed*.whl"))


def main() -> None:
    """Compile, build, and print sizes and times."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the wheels")
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--level", help=argparse.SUPPRESS)
    parser.add_argument("jobs", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.into is not None:
        _compile_here(given.level, given.into, given.jobs)
        return
    archives = given.out / "kernels"
    archives.mkdir(parents=True, exist_ok=True)
    discard_outdated(archives)
    levels = release.levels()
    for level in release.LEVELS:
        if level in levels:
            _report(compile_archive(level, archives, release_jobs()))
        else:
            print(f"{level}: this processor cannot run it; machines of this level will use the one below")  # noqa: T201
    for old in given.out.glob("fringed*.whl"):
        old.unlink()
    for wheel in build_wheels(given.out, archives):
        print(f"{wheel.name}: {wheel.stat().st_size / 1e6:.2f} MB")  # noqa: T201


def _compile_here(level: str, folder: Path, jobs: Sequence[str]) -> None:
    """In the process whose environment names the level."""
    from daemon.kernels.processes import compile_kernels

    start_s = time.monotonic()
    compile_kernels(jobs)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    pack(Path(os.environ["NUMBA_CACHE_DIR"]), folder, level)
    seconds = f"{time.monotonic() - start_s:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processor time"
    print(f"{level}: {len(jobs)} jobs compiled in {seconds}")  # noqa: T201


def _report(description: Path) -> None:
    archive = description.with_suffix(".tar.xz")
    print(f"{archive.name}: {archive.stat().st_size / 1e6:.2f} MB")  # noqa: T201


if __name__ == "__main__":
    main()
