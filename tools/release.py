"""``python -m tools.release``: the wheels of both distributions, with compiled kernels for this Python, in ``dist/``.

The kernels are compiled for each level of x86-64 that this processor can run, for it must run them once. Archives of
other Pythons that were made from the same sources are kept: run it with each of them, the last wheel has them all.
At the end the wheels are installed in a new environment, where no kernel may be compiled.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from daemon.kernels import cache, release
from daemon.kernels.archive import ArchiveError, description_file, pack, read_description
from daemon.kernels.jobs import release_jobs
from tools.release_check import check_versions, compilations, new_environment

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


def build_wheels(out: Path, archives: Path | None) -> list[Path]:
    """Build the wheels of both distributions with this environment's tools, the rig's with the archives of a folder."""
    environment = dict(os.environ)
    environment.pop(ARCHIVES, None)
    if archives is not None:
        environment[ARCHIVES] = str(archives.resolve())
    pip = [sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps"]
    pip.append("--no-build-isolation")
    subprocess.run(
        [*pip, "--wheel-dir", str(out), str(ROOT), str(ROOT / "distributions/rig")], env=environment, check=True
    )
    return sorted(out.glob("fringed*.whl"))


def write_checksums(folder: Path) -> Path:
    """Write ``SHA256SUMS`` of all files in a folder, for ``sha256sum --check``; returns its path."""
    target = folder / "SHA256SUMS"
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path != target)
    lines = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(folder)}\n" for path in files]
    target.write_text("".join(lines), encoding="utf-8")
    return target


def check_installation(wheels: Iterable[Path], levels: Iterable[str], jobs: Sequence[str]) -> None:
    """Install wheels and what they require in a new environment, and run all kernels there.

    Raises:
        RuntimeError: a kernel was compiled, or something was logged.
    """
    with tempfile.TemporaryDirectory(prefix="fringed-install-") as name:
        folder = Path(name)
        python = new_environment(folder / "env", wheels, ["--constraint", str(ROOT / "constraints.txt")])
        for level in levels:
            count, logged = compilations(python, folder, level, jobs)
            if count or logged:
                raise RuntimeError(f"{level}: the installed wheel compiled {count} kernels: {logged.strip()}")


def main() -> None:
    """Check, compile, build, check again; print sizes, and the time of each step."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the wheels")
    parser.add_argument("--into", type=Path, help=argparse.SUPPRESS)
    parser.add_argument("--level", help=argparse.SUPPRESS)
    parser.add_argument("jobs", nargs="*", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.into is not None:
        _compile_here(given.level, given.into, given.jobs)
        return
    with _step("versions"):
        print(f"version {check_versions(ROOT)}")  # noqa: T201
    archives = given.out / "kernels"
    archives.mkdir(parents=True, exist_ok=True)
    discard_outdated(archives)
    levels = [level for level in reversed(release.LEVELS) if level in release.levels()]
    for level in release.LEVELS:
        if level not in levels:
            print(f"{level}: this processor cannot run it; machines of this level will use the one below")  # noqa: T201
    for level in levels:
        with _step(f"kernels for {level}"):
            compile_archive(level, archives, release_jobs())
    with _step("wheels and checksums"):
        for old in given.out.glob("fringed*.whl"):
            old.unlink()
        wheels = build_wheels(given.out, archives)
        write_checksums(given.out)
    with _step("installation in a new environment"):
        check_installation(wheels, levels, release_jobs())
    for path in (*wheels, *archives.glob("*.tar.xz")):
        print(f"{path.relative_to(given.out)}: {path.stat().st_size / 1e6:.2f} MB")  # noqa: T201


@contextmanager
def _step(name: str) -> Iterator[None]:
    start_s = time.monotonic()
    yield
    print(f"{name}: {time.monotonic() - start_s:.0f} s", flush=True)  # noqa: T201


def _compile_here(level: str, folder: Path, jobs: Sequence[str]) -> None:
    """In the process whose environment names the level."""
    from daemon.kernels.processes import compile_kernels

    start_s = time.monotonic()
    compile_kernels(jobs)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    pack(Path(os.environ["NUMBA_CACHE_DIR"]), folder, level)
    seconds = f"{time.monotonic() - start_s:.0f} s, {used.ru_utime + used.ru_stime:.0f} s of processor time"
    print(f"{level}: {len(jobs)} jobs compiled in {seconds}")  # noqa: T201


if __name__ == "__main__":
    main()
