"""The machine, or the image of one below a directory, that is installed into."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import PREFIX, Place, moved

MARK = "installed.json"
_SYSTEM = "bin boot dev etc home lib lib32 lib64 media mnt opt proc root run sbin srv sys tmp usr var"
_BELOW_USR = "bin include lib lib64 libexec local sbin share src local/bin local/lib local/share"
_BELOW_VAR = "cache lib log opt run spool tmp"
_REFUSED = {
    *(f"/{name}" for name in _SYSTEM.split()),
    *(f"/usr/{name}" for name in _BELOW_USR.split()),
    *(f"/var/{name}" for name in _BELOW_VAR.split()),
}


@dataclass(frozen=True, slots=True)
class Target:
    """What is installed where.

    Args:
        root: ``/``, or the directory of an image; prefix: of the program on that machine.
    """

    root: Path = Path("/")
    prefix: Path = PREFIX

    @property
    def live(self) -> bool:
        """Whether it is this machine and no image."""
        return self.root == Path("/")

    @property
    def systemd(self) -> bool:
        """Whether a systemd runs there that can be told."""
        return self.live and Path("/run/systemd/system").is_dir()

    def path(self, place: Path) -> Path:
        """Where a path of that machine is for this program."""
        return self.root / moved(place, self.prefix).relative_to("/")

    def set_rights(self, place: Place) -> None:
        """Give a directory or file its mode and, as root, its owner."""
        path = self.path(place.path)
        if os.geteuid() == 0:
            os.chown(path, self.number("passwd", place.owner), self.number("group", place.group), follow_symlinks=False)
        path.chmod(place.mode)

    def number(self, table: str, name: str) -> int:
        """The number of a user (``passwd``) or a group (``group``) on that machine."""
        try:
            lines = (self.root / "etc" / table).read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            lines = []
        for line in lines:
            fields = line.split(":")
            if fields[0] == name and len(fields) > 2 and fields[2].isdigit():
                return int(fields[2])
        if name == "root":
            return 0
        raise InstallError(f"{self.root / 'etc' / table} has no {name}; systemd-sysusers did not make it")


def check_prefix(target: Target) -> None:
    """Refuse a prefix that is not ours alone.

    Raises:
        InstallError: it is relative, a directory of the system, or one that holds something else.
    """
    prefix, ours = target.prefix, "choose a directory of its own such as /opt/fringed"
    if not prefix.is_absolute() or ".." in prefix.parts:
        raise InstallError(f"--prefix {prefix} is not an absolute path; {ours}")
    if any(character.isspace() or character in "%$\"'\\" for character in str(prefix)):
        raise InstallError(f"--prefix {str(prefix)!r} has characters that unit files do not take; {ours}")
    if prefix == Path("/") or str(prefix) in _REFUSED or prefix.parts[1] in ("dev", "proc", "sys", "run", "tmp"):
        raise InstallError(f"--prefix {prefix} belongs to the system; {ours}")
    for place in (target.path(prefix), *target.path(prefix).parents):
        if place.is_symlink():
            raise InstallError(f"--prefix {prefix}: {place} is a link; {ours}")
        if place.exists() and not place.is_dir():
            raise InstallError(f"--prefix {prefix}: {place} is no directory; {ours}")
        if place == target.root:
            break
    there = target.path(prefix)
    if there.is_dir() and any(there.iterdir()) and not (there / MARK).is_file():
        raise InstallError(f"--prefix {prefix} is not empty and was not made by fringed install; {ours}")


def reachable(program: Path) -> Path | None:
    """The first directory above a program that other users cannot enter; None when they reach it."""
    for above in reversed(program.resolve().parents):
        if not above.stat().st_mode & stat.S_IXOTH:
            return above
    return None
