"""The Python environment of the service: made beside the old one, then put in its place by one rename."""

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
from daemon.apps.install.target import Target, reachable

OWN = "fringed", "pipeline", "drivers", "sim", "daemon"
_CHECKOUT = Path(__file__).resolve().parents[3]
_TIMEOUT_S = 3600
_MARK = "made-from"  # in an environment that is whole


@dataclass(frozen=True, slots=True)
class Source:
    """Where Python and the packages come from.

    Args:
        python: the interpreter; wheelhouse: a directory of wheels to take packages from instead of an index.
        shared: use the packages of the environment that runs this command where they are, and download nothing.
    """

    python: Path
    wheelhouse: Path | None = None
    shared: bool = False

    def check(self, target: Target) -> None:
        """Refuse an interpreter that the service's user could not start."""
        places = [self.python, *(site_packages() if self.shared else ())]
        for place in places if target.live else ():
            closed = reachable(place)
            if closed is not None:
                raise InstallError(
                    f"{place}: other users may not enter {closed}; name an interpreter of the system with "
                    f"--python /usr/bin/python3, or chmod o+x {closed}"
                )


def make(target: Target, source: Source) -> bool:
    """Make the environment unless it is there already; returns whether it was made."""
    link, wanted = target.path(target.prefix / "env"), fingerprint(source)
    if link.is_symlink() and _read(link / _MARK) == wanted:
        return False
    fresh = target.path(target.prefix / f"env-{secrets.token_hex(4)}")
    try:
        _fill(fresh, source)
        (fresh / _MARK).write_text(wanted, encoding="utf-8")
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
    """Remove environments but this one and the one before, with which a daemon may still be running."""
    link = target.path(target.prefix / "env")
    others = [place for place in link.parent.glob("env-*") if place.is_dir() and place.name != link.readlink().name]
    whole = [place for place in others if (place / _MARK).is_file()]
    before = max(whole, key=lambda place: (place / _MARK).stat().st_mtime_ns, default=None)
    for place in others:
        if place != before:
            shutil.rmtree(place, ignore_errors=True)


def fingerprint(source: Source) -> str:
    """Tells one environment from another: Python, where the packages come from, and every file of ours."""
    digest = hashlib.sha256(json.dumps([str(source.python), str(source.wheelhouse), source.shared]).encode())
    digest.update(shipped("constraints.txt").read_bytes())
    for package in OWN:
        for path in sorted((_CHECKOUT / package).rglob("*")):
            if path.is_file() and path.suffix not in (".pyc", ".nbi", ".nbc"):
                digest.update(f"{path.relative_to(_CHECKOUT)}\0".encode() + path.read_bytes())
    return digest.hexdigest()


def site_packages() -> list[Path]:
    """Where the packages of the environment that runs this lie."""
    paths = sysconfig.get_paths()
    return [Path(place) for place in dict.fromkeys((paths["purelib"], paths["platlib"]))]


def _fill(fresh: Path, source: Source) -> None:
    options = ["--without-pip"] if source.shared else []
    _run([str(source.python), "-m", "venv", *options, str(fresh)], "making the environment")
    if not source.shared:
        _install(fresh, source)
        return
    (own,) = fresh.glob("lib/python3.*/site-packages")
    for package in OWN:
        shutil.copytree(_CHECKOUT / package, own / package, ignore=shutil.ignore_patterns("__pycache__"))
    share = fresh / SHARE
    shutil.copytree(shipped("systemd"), share / "systemd")
    shutil.copy2(shipped("constraints.txt"), share)
    # A line of its own for each directory: what lies there is found, its .pth files are not followed.
    (own / "shared.pth").write_text("".join(f"{place}\n" for place in site_packages()), encoding="utf-8")


def _install(fresh: Path, source: Source) -> None:
    pip = [str(fresh / "bin/python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    if source.wheelhouse is not None:
        pip += ["--no-index", "--find-links", str(source.wheelhouse)]
    pip += ["--constraint", str(shipped("constraints.txt")), requirement(source)]
    _run(pip, "installing the packages")


def requirement(source: Source) -> str:
    """What pip is to install: the checkout that runs this, or the same version from where packages come from."""
    from daemon.common.version import program_version

    if source.wheelhouse is None and (_CHECKOUT / "pyproject.toml").is_file():
        return f"{_CHECKOUT}[rig]"
    return f"fringed[rig]=={program_version()}"


def _run(command: list[str], what: str) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    try:
        done = subprocess.run(
            command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=_TIMEOUT_S,
            check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired) as error:
        raise InstallError(f"{what} failed: {error}") from error
    if done.returncode:
        raise InstallError(f"{what} failed ({' '.join(command[:4])} ...):\n{done.stderr.strip()[-2000:]}")


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except OSError:
        return ""


def default_python() -> Path:
    """The interpreter below the environment that runs this."""
    return Path(getattr(sys, "_base_executable", sys.executable))
