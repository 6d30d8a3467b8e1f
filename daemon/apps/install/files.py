"""The files that a service manager reads, and small programs, put in place with the right prefix."""

from __future__ import annotations

import sys
from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import COMMAND, DIRECTORIES, FILES, PREFIX, PROGRAMS, Place
from daemon.apps.install.target import Target
from daemon.common.files import write_atomically

SHARE = Path("share/fringed")
"""Where an installed package has what is no Python, below the prefix of its environment."""

_WRAPPER = """\
#!/bin/sh
unset PYTHONPATH PYTHONHOME
exec {prefix}/env/bin/python -P -c 'import sys; from daemon.cli.entry import main; sys.argv[0] = "fringed"; main()' "$@"
"""


def shipped(name: str) -> Path:
    """A file or directory of the checkout's root, or what an installed package has of it.

    Raises:
        InstallError: neither is there.
    """
    places = [Path(__file__).resolve().parents[3] / name, Path(sys.prefix) / SHARE / name]
    for place in places:
        if place.exists():
            return place
    raise InstallError(f"{' and '.join(map(str, places))} are not there; install the whole project again")


def sources() -> Path:
    """Where the unit files are."""
    return shipped("systemd")


def make_directories(target: Target) -> None:
    """Every directory of the table, with its mode and owner."""
    for place in DIRECTORIES:
        target.path(place.path).mkdir(parents=True, exist_ok=True)
        target.set_rights(place)


def put_users_file(target: Target) -> None:
    """What systemd-sysusers reads comes first: the owners of everything else."""
    _put(target, "sysusers.d/fringed.conf", FILES["sysusers.d/fringed.conf"])


def put_all(target: Target) -> list[Path]:
    """Every file that differs from what is there; returns those."""
    changed = [place.path for name, place in (FILES | PROGRAMS).items() if _put(target, name, place)]
    wrapper = Place(PREFIX / "bin/fringed", 0o755)
    if _write(target, wrapper, _WRAPPER.format(prefix=target.prefix).encode()):
        changed.append(wrapper.path)
    _link(target)
    return changed


def _put(target: Target, name: str, place: Place) -> bool:
    text = (sources() / name).read_text(encoding="utf-8").replace(str(PREFIX), str(target.prefix))
    return _write(target, place, text.encode())


def _write(target: Target, place: Place, data: bytes) -> bool:
    path = target.path(place.path)
    path.parent.mkdir(parents=True, exist_ok=True)
    same = path.is_file() and path.read_bytes() == data
    if not same:
        write_atomically(path, data)
    target.set_rights(place)
    return not same


def _link(target: Target) -> None:
    """The command for everybody; somebody else's program of that name is left alone."""
    path, to = target.path(COMMAND), target.prefix / "bin/fringed"
    if path.is_symlink() or not path.exists():
        path.parent.mkdir(parents=True, exist_ok=True)
        path.unlink(missing_ok=True)
        path.symlink_to(to)
