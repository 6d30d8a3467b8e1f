"""Where everything lies on an installed machine, with modes and owners: what the tests hold the installation to."""

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
class Place:
    """A directory or file.

    Args:
        mode: its permissions; owner, group: their names.
        data: whether it stays when the program is taken away.
    """

    path: Path
    mode: int
    owner: str = "root"
    group: str = "root"
    data: bool = False


DIRECTORIES: tuple[Place, ...] = (
    Place(PREFIX, 0o755),
    Place(PREFIX / "bin", 0o755),
    Place(PREFIX / "libexec", 0o755),
    Place(CONFIG, 0o755, data=True),
    Place(CONFIG / "keys", 0o750, "root", USER, data=True),
    Place(STATE, 0o750, USER, USER, data=True),
    Place(STATE / "takes", 0o750, USER, USER, data=True),
    Place(STATE / "selfcheck", 0o750, USER, USER, data=True),
    Place(CACHE, 0o750, USER, USER),
    Place(LOGS, 0o750, USER, USER, data=True),
)
"""In the order in which they are made."""

CONFIG_FILES = Place(RIG, 0o640, "root", USER, data=True)
"""How every file of the configuration is kept."""

PROGRAMS: dict[str, Place] = {
    "libexec/projector-x": Place(PREFIX / "libexec/projector-x", 0o755),
}
"""Files below ``systemd/`` that are programs."""

FILES: dict[str, Place] = {
    **{unit: Place(Path("/etc/systemd/system") / unit, 0o644) for unit in UNITS},
    "user/fringed-user.service": Place(Path("/etc/systemd/user/fringed-user.service"), 0o644),
    "sysusers.d/fringed.conf": Place(Path("/etc/sysusers.d/fringed.conf"), 0o644),
    "tmpfiles.d/fringed.conf": Place(Path("/etc/tmpfiles.d/fringed.conf"), 0o644),
    "udev/70-fringed.rules": Place(Path("/etc/udev/rules.d/70-fringed.rules"), 0o644),
}
"""Files below ``systemd/`` by where they go."""


def moved(place: Path, prefix: Path) -> Path:
    """A path of the table for another prefix."""
    return prefix / place.relative_to(PREFIX) if place.is_relative_to(PREFIX) else place
