"""The destination of an installation: this machine, or the image of one below a directory."""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import PREFIX, InstalledPath, with_prefix

MARK = "installed.json"
_SYSTEM = "bin boot dev etc home lib lib32 lib64 media mnt opt proc root run sbin srv sys tmp usr var"
_BELOW_USR = "bin include lib lib64 libexec local sbin share src local/bin local/lib local/share"
_BELOW_VAR = "cache lib log opt run spool tmp"
_RESERVED = {
    *(f"/{name}" for name in _SYSTEM.split()),
    *(f"/usr/{name}" for name in _BELOW_USR.split()),
    *(f"/var/{name}" for name in _BELOW_VAR.split()),
}


@dataclass(frozen=True, slots=True)
class Target:
    """The destination of an installation.

    Args:
        root: ``/``, or the directory of an image; prefix: of the program on that machine.
    """

    root: Path = Path("/")
    prefix: Path = PREFIX

    @property
    def live(self) -> bool:
        """Whether it is this machine, not an image."""
        return self.root == Path("/")

    @property
    def systemd(self) -> bool:
        """Whether systemd runs on the target."""
        return self.live and Path("/run/systemd/system").is_dir()

    def path(self, path: Path) -> Path:
        """The location of a target's path on this machine."""
        return self.root / with_prefix(path, self.prefix).relative_to("/")

    def set_permissions(self, entry: InstalledPath) -> None:
        """Set the mode of a directory or file and, as root, its owner."""
        path = self.path(entry.path)
        if os.geteuid() == 0:
            os.chown(path, self.number("passwd", entry.owner), self.number("group", entry.group), follow_symlinks=False)
        path.chmod(entry.mode)

    def number(self, table: str, name: str) -> int:
        """The id of a user (``passwd``) or a group (``group``) on the target."""
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
        raise InstallError(f"{self.root / 'etc' / table} has no {name}; systemd-sysusers did not create it")


def check_prefix(target: Target) -> None:
    """Check that a prefix is reserved for this program.

    Raises:
        InstallError: it is relative, a directory of the system, or one with other files.
    """
    prefix, remedy = target.prefix, "choose a directory of its own such as /opt/fringed"
    if not prefix.is_absolute() or ".." in prefix.parts:
        raise InstallError(f"--prefix {prefix} is not an absolute path; {remedy}")
    if any(character.isspace() or character in "%$\"'\\" for character in str(prefix)):
        raise InstallError(f"--prefix {str(prefix)!r} has characters that unit files do not accept; {remedy}")
    if prefix == Path("/") or str(prefix) in _RESERVED or prefix.parts[1] in ("dev", "proc", "sys", "run", "tmp"):
        raise InstallError(f"--prefix {prefix} belongs to the system; {remedy}")
    for path in (target.path(prefix), *target.path(prefix).parents):
        if path.is_symlink():
            raise InstallError(f"--prefix {prefix}: {path} is a link; {remedy}")
        if path.exists() and not path.is_dir():
            raise InstallError(f"--prefix {prefix}: {path} is no directory; {remedy}")
        if path == target.root:
            break
    directory = target.path(prefix)
    if directory.is_dir() and any(directory.iterdir()) and not (directory / MARK).is_file():
        raise InstallError(f"--prefix {prefix} is not empty and was not created by fringed install; {remedy}")


def first_closed_directory(program: Path) -> Path | None:
    """The first directory above a program that other users cannot enter, None if there is none."""
    for parent in reversed(program.resolve().parents):
        if not parent.stat().st_mode & stat.S_IXOTH:
            return parent
    return None
