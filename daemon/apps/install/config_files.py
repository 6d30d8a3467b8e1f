"""rig.yaml and what it names, put below /etc/fringed; a file of the user is never written over."""

from __future__ import annotations

from pathlib import Path

from daemon.apps.install.errors import InstallError
from daemon.apps.install.layout import CONFIG, CONFIG_FILES, RIG, STATE, Place
from daemon.apps.install.target import Target
from daemon.common.files import write_atomically
from daemon.config import load_rig
from daemon.config.yaml_source import read_yaml

_NAMED = "calibration", "pattern", "volume"

SIMULATED = f"""\
# The rig of fringed.service. Until there is a real one, a simulated rig measures a moving scene.
# fringed check {RIG} tells every mistake; systemctl reload fringed takes over what can change while measuring.
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


def gather(rig: Path | None) -> dict[Path, bytes]:
    """What is to lie below /etc/fringed, by path; checked before anything is touched.

    Raises:
        ConfigError: rig.yaml has mistakes; InstallError: it names files that cannot come along.
    """
    if rig is None:
        return {RIG: SIMULATED.encode()}
    load_rig(rig)
    data = read_yaml(rig.read_text(encoding="utf-8")).data
    found = {RIG: rig.read_bytes()}
    for key in _NAMED:
        name = data.get(key)
        if not isinstance(name, str) or Path(name).is_absolute():
            continue
        if ".." in Path(name).parts or name.startswith("~"):
            raise InstallError(f"{rig}: {key} is {name!r}; put the file beside {rig.name}, or name its whole path")
        found[CONFIG / name] = (rig.parent / name).read_bytes()
    return found


def put(target: Target, files: dict[Path, bytes]) -> list[str]:
    """Write what is not there; what is there and differs gets the new one beside it as ``*.new``."""
    said = []
    for path, data in files.items():
        to = target.path(path)
        if to.is_file() and to.read_bytes() == data:
            continue
        place = path
        if to.exists():
            place = path.with_name(f"{path.name}.new")
            said.append(f"{path} is kept; the new one is {place}")
        target.path(place).parent.mkdir(parents=True, exist_ok=True)
        write_atomically(target.path(place), data)
        target.set_rights(Place(place, CONFIG_FILES.mode, CONFIG_FILES.owner, CONFIG_FILES.group))
    return said
