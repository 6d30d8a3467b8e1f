"""Unit files and small programs, installed with the prefix."""

from __future__ import annotations

import sys
from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import COMMAND, DIRECTORIES, FILES, PREFIX, PROGRAMS, InstalledPath
from daemon.apps.install.target import Target
from daemon.common.files import write_atomically

SHARE = Path("share/fringed")
"""Directory of the other files of an installed package, below the prefix of its environment."""

_WRAPPER = """\
#!/bin/sh
unset PYTHONPATH PYTHONHOME
exec {prefix}/env/bin/python -P -c 'import sys; from daemon.cli.entry import main; sys.argv[0] = "fringed"; main()' "$@"
"""


def shipped(name: str) -> Path:
    """A file or directory of the checkout's root, or its copy in an installed package.

    Raises:
        InstallError: neither exists.
    """
    paths = [Path(__file__).resolve().parents[3] / name, Path(sys.prefix) / SHARE / name]
    for path in paths:
        if path.exists():
            return path
    raise InstallError(f"{' and '.join(map(str, paths))} do not exist; install the complete project again")


def sources() -> Path:
    """The directory of the unit files."""
    return shipped("systemd")


def make_directories(target: Target) -> None:
    """Create every directory of the table with its mode and owner."""
    for directory in DIRECTORIES:
        target.path(directory.path).mkdir(parents=True, exist_ok=True)
        target.set_permissions(directory)


def write_users_file(target: Target) -> None:
    """Write the file for systemd-sysusers, which creates the owners of the other files."""
    _copy(target, "sysusers.d/fringed.conf", FILES["sysusers.d/fringed.conf"])


def write_all(target: Target) -> list[Path]:
    """Write every file and return those that changed."""
    changed = [file.path for name, file in (FILES | PROGRAMS).items() if _copy(target, name, file)]
    wrapper = InstalledPath(PREFIX / "bin/fringed", 0o755)
    if _write(target, wrapper, _WRAPPER.format(prefix=target.prefix).encode()):
        changed.append(wrapper.path)
    _link(target)
    return changed


def _copy(target: Target, name: str, file: InstalledPath) -> bool:
    text = (sources() / name).read_text(encoding="utf-8").replace(str(PREFIX), str(target.prefix))
    return _write(target, file, text.encode())


def _write(target: Target, file: InstalledPath, data: bytes) -> bool:
    path = target.path(file.path)
    path.parent.mkdir(parents=True, exist_ok=True)
    same = path.is_file() and path.read_bytes() == data
    if not same:
        write_atomically(path, data)
    target.set_permissions(file)
    return not same


def _link(target: Target) -> None:
    """Link the command for all users; another program of the same name is kept."""
    path, program = target.path(COMMAND), target.prefix / "bin/fringed"
    if path.is_symlink() or not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.symlink_to(program)
