"""The table of installed files and directories with their modes and owners; the tests compare with it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

PREFIX = Path("/opt/fringed")
CONFIG = Path("/etc/fringed")
RIG = CONFIG / "rig.yaml"
STATE = Path("/var/lib/fringed")
CACHE = Path("/var/cache/fringed")
KERNELS = CACHE / "numba"
LOGS = Path("/var/log/fringed")
COMMAND = Path("/usr/local/bin/fringed")

USER = "fringed"
VIEW_USER = "fringed-view"
SERVICE, X, VIEW = "fringed.service", "fringed-projector-x.service", "fringed-view.service"
UNITS = SERVICE, X, VIEW


@dataclass(frozen=True, slots=True)
class InstalledPath:
    """An installed directory or file.

    Args:
        mode: permissions; owner, group: names.
        data: whether it is kept when the program is removed.
    """

    path: Path
    mode: int
    owner: str = "root"
    group: str = "root"
    data: bool = False


DIRECTORIES: tuple[InstalledPath, ...] = (
    InstalledPath(PREFIX, 0o755),
    InstalledPath(PREFIX / "bin", 0o755),
    InstalledPath(PREFIX / "libexec", 0o755),
    InstalledPath(CONFIG, 0o755, data=True),
    InstalledPath(CONFIG / "keys", 0o750, "root", USER, data=True),
    InstalledPath(STATE, 0o750, USER, USER, data=True),
    InstalledPath(STATE / "takes", 0o750, USER, USER, data=True),
    InstalledPath(STATE / "selfcheck", 0o750, USER, USER, data=True),
    InstalledPath(CACHE, 0o750, USER, USER),
    InstalledPath(LOGS, 0o750, USER, USER, data=True),
)
"""In the order of their creation."""

CONFIG_FILES = InstalledPath(RIG, 0o640, "root", USER, data=True)
"""Mode and owner of every configuration file."""

PROGRAMS: dict[str, InstalledPath] = {
    "libexec/projector-x": InstalledPath(PREFIX / "libexec/projector-x", 0o755),
}
"""Programs below ``systemd/``."""

FILES: dict[str, InstalledPath] = {
    **{unit: InstalledPath(Path("/etc/systemd/system") / unit, 0o644) for unit in UNITS},
    "user/fringed-user.service": InstalledPath(Path("/etc/systemd/user/fringed-user.service"), 0o644),
    "sysusers.d/fringed.conf": InstalledPath(Path("/etc/sysusers.d/fringed.conf"), 0o644),
    "tmpfiles.d/fringed.conf": InstalledPath(Path("/etc/tmpfiles.d/fringed.conf"), 0o644),
    "udev/70-fringed.rules": InstalledPath(Path("/etc/udev/rules.d/70-fringed.rules"), 0o644),
}
"""Other files below ``systemd/`` with their destinations."""


def with_prefix(path: Path, prefix: Path) -> Path:
    """A path of the table for another prefix."""
    return prefix / path.relative_to(PREFIX) if path.is_relative_to(PREFIX) else path
