"""The Python environment of the service: created beside the old one, then activated by one rename."""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import shutil
import subprocess
import sys
import sysconfig
from dataclasses import dataclass
from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.files import SHARE, shipped
from daemon.apps.install.target import Target, first_closed_directory
from daemon.common.files import source_files

OWN = "fringed", "pipeline", "drivers", "sim", "daemon"
_CHECKOUT = Path(__file__).resolve().parents[3]
_TIMEOUT_S = 3600
_MARK = "made-from"  # marks a complete environment


@dataclass(frozen=True, slots=True)
class Source:
    """The source of Python and of the packages.

    Args:
        python: the interpreter; wheelhouse: a directory of wheels used instead of an index.
        shared: use the packages of the environment that runs this command in place, without a download.
    """

    python: Path
    wheelhouse: Path | None = None
    shared: bool = False

    def check(self, target: Target) -> None:
        """Reject an interpreter that the service's user cannot start."""
        paths = [self.python, *(site_packages() if self.shared else ())]
        for path in paths if target.live else ():
            closed = first_closed_directory(path)
            if closed is not None:
                raise InstallError(
                    f"{path}: other users cannot enter {closed}; give an interpreter of the system with "
                    f"--python /usr/bin/python3, or chmod o+x {closed}"
                )


def make(target: Target, source: Source) -> bool:
    """Create the environment unless it exists; returns whether it was created."""
    link, identity = target.path(target.prefix / "env"), fingerprint(source)
    if link.is_symlink() and _read(link / _MARK) == identity:
        return False
    fresh = target.path(target.prefix / f"env-{secrets.token_hex(4)}")
    try:
        _fill(fresh, source)
        (fresh / _MARK).write_text(identity, encoding="utf-8")
        for path in (fresh, *fresh.rglob("*")):
            if not path.is_symlink():
                path.chmod((path.stat().st_mode | 0o444 | (0o111 if path.is_dir() else 0)) & ~0o7022)
    except BaseException:
        shutil.rmtree(fresh, ignore_errors=True)
        raise
    new = link.with_name(f"{fresh.name}.link")
    new.symlink_to(fresh.name)
    new.replace(link)
    return True


def remove_old(target: Target) -> None:
    """Remove all environments but the current and the previous one, which a daemon may still use."""
    link = target.path(target.prefix / "env")
    others = [path for path in link.parent.glob("env-*") if path.is_dir() and path.name != link.readlink().name]
    complete = [path for path in others if (path / _MARK).is_file()]
    previous = max(complete, key=lambda path: (path / _MARK).stat().st_mtime_ns, default=None)
    for path in others:
        if path != previous:
            shutil.rmtree(path, ignore_errors=True)


def fingerprint(source: Source) -> str:
    """Identifies an environment: Python, the source of the packages, and every file of this project."""
    digest = hashlib.sha256(json.dumps([str(source.python), str(source.wheelhouse), source.shared]).encode())
    digest.update(shipped("constraints.txt").read_bytes())
    for package in OWN:
        for path in source_files(_CHECKOUT / package):
            digest.update(f"{path.relative_to(_CHECKOUT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def site_packages() -> list[Path]:
    """The package directories of the running environment."""
    paths = sysconfig.get_paths()
    return [Path(path) for path in dict.fromkeys((paths["purelib"], paths["platlib"]))]


def _fill(fresh: Path, source: Source) -> None:
    options = ["--without-pip"] if source.shared else []
    _run([str(source.python), "-m", "venv", *options, str(fresh)], "creating the environment")
    if not source.shared:
        _install(fresh, source)
        return
    (own,) = fresh.glob("lib/python3.*/site-packages")
    for package in OWN:
        shutil.copytree(_CHECKOUT / package, own / package, ignore=shutil.ignore_patterns("__pycache__"))
    # The service cannot write beside its files: without this every start would compile all of them.
    packages = [str(own / package) for package in OWN]
    _run([str(fresh / "bin/python"), "-m", "compileall", "-q", *packages], "compiling the packages to bytecode")
    share = fresh / SHARE
    shutil.copytree(shipped("systemd"), share / "systemd")
    shutil.copy2(shipped("constraints.txt"), share)
    # One line for each directory: its packages are importable, its .pth files are not processed.
    (own / "shared.pth").write_text("".join(f"{path}\n" for path in site_packages()), encoding="utf-8")


def _install(fresh: Path, source: Source) -> None:
    pip = [str(fresh / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if source.wheelhouse is not None:
        pip += ["--no-index", "--find-links", str(source.wheelhouse)]
    pip += ["--constraint", str(shipped("constraints.txt")), *requirements(source)]
    _run(pip, "installing the packages")


def requirements(source: Source) -> list[str]:
    """The requirements for pip: the running checkout, or the same version from the source of packages."""
    from daemon.common.version import program_version

    if source.wheelhouse is None and (_CHECKOUT / "pyproject.toml").is_file():
        return [str(_CHECKOUT), f"{_CHECKOUT}/distributions/rig[view]"]
    return [f"fringed-rig[view]=={program_version()}"]


def _run(command: list[str], step: str) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    try:
        process = subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TIMEOUT_S,
            check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InstallError(f"{step} failed: {error}") from error
    if process.returncode:
        raise InstallError(f"{step} failed ({' '.join(command[:4])} ...):\n{process.stderr.strip()[-2000:]}")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def default_python() -> Path:
    """The base interpreter of the running environment."""
    return Path(getattr(sys, "_base_executable", sys.executable))  # private in CPython, absent in other Pythons
