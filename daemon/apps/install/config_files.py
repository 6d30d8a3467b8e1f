"""rig.yaml and the files that it names below /etc/fringed; a file of the user is never overwritten."""

from __future__ import annotations

from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import CONFIG, CONFIG_FILES, RIG, STATE, InstalledPath
from daemon.apps.install.target import Target
from daemon.common.files import write_atomically
from daemon.config import load_rig
from daemon.config.yaml_source import read_yaml

_NAMED = "calibration", "pattern", "volume"

SIMULATED = f"""\
# The rig of fringed.service. Until there is a real one, a simulated rig measures a moving scene.
# fringed check {RIG} reports every error; systemctl reload fringed applies changes while measuring.
device:
  name: rig-01

cameras:
  driver: sim

simulation:
  scene: moving
  frames: 12
  rate_hz: 4.0

stream:
  endpoints: ["ipc:///run/fringed/stream", "tcp://127.0.0.1:5555"]

control:
  endpoint: ipc:///run/fringed/control

recording:
  dir: {STATE}/takes

selfcheck:
  dir: {STATE}/selfcheck
"""


def collect_files(rig: Path | None) -> dict[Path, bytes]:
    """The files for /etc/fringed, by path; checked before any change.

    Raises:
        ConfigError: rig.yaml has errors; InstallError: it names files that cannot be copied.
    """
    if rig is None:
        return {RIG: SIMULATED.encode()}
    load_rig(rig)
    data = read_yaml(rig.read_text(encoding="utf-8")).data
    files = {RIG: rig.read_bytes()}
    for key in _NAMED:
        name = data.get(key)
        if not isinstance(name, str) or Path(name).is_absolute():
            continue
        if ".." in Path(name).parts or name.startswith("~"):
            raise InstallError(f"{rig}: {key} is {name!r}; put the file beside {rig.name}, or give its absolute path")
        files[CONFIG / name] = (rig.parent / name).read_bytes()
    return files


def write_files(target: Target, files: dict[Path, bytes]) -> list[str]:
    """Write the files; an existing different one is kept, and the new one is written beside it as ``*.new``."""
    messages = []
    for path, data in files.items():
        existing = target.path(path)
        if existing.is_file() and existing.read_bytes() == data:
            continue
        destination = path
        if existing.exists():
            destination = path.with_name(f"{path.name}.new")
            messages.append(f"{path} is kept; the new file is {destination}")
        target.path(destination).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target.path(destination), data)
        target.set_permissions(InstalledPath(destination, CONFIG_FILES.mode, CONFIG_FILES.owner, CONFIG_FILES.group))
    return messages
