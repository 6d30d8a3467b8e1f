"""Emulated hardware inside the container: cameras in front of the service's own X server."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from sim.box.box import heads
from sim.box.options import from_mapping
from sim.box.xserver import configuration
from tests.nspawn.helpers import POLL_S, Fringed
from tools.nspawn.machine import WAIT_S
from tools.waiting import wait_until

X = "fringed-projector-x.service"
BOX = "rig-box.service"
FOLDER = "/run/rig"
GENTL = f"{FOLDER}/gentl"
OPTIONS: dict[str, Any] = {
    "folder": FOLDER,
    "display": ":9",
    "tcp": 0,
    "exposure_us": 1000,
    "daemon": False,
    "simulation": {"scene": "plane", "frames": 1, "rate_hz": 5.0, "layout": {"scale": 0.125}},
}
_ENVIRONMENT = {
    "HOME": "/var/lib/fringed",
    "XDG_CACHE_HOME": "/var/cache",
    "NUMBA_CACHE_DIR": "/var/cache/fringed/numba",
    "XAUTHORITY": "/run/fringed-x/authority",
}
DROP_IN = f"ReadWritePaths={FOLDER}\nEnvironment=FRINGED_GENTL_DIR={GENTL}"
"""Settings of the units for emulated cameras, which are files where real ones are devices."""


def start_x(fringed: Fringed) -> None:
    """The projector's X server, without hardware."""
    fringed.write("/etc/fringed/xorg.conf", configuration(heads(from_mapping(OPTIONS))))
    fringed.write("/etc/fringed/xorg.conf.d/empty.conf", "")
    options = "-config /etc/fringed/xorg.conf -configdir /etc/fringed/xorg.conf.d"
    fringed.write("/etc/fringed/projector-x.environment", f"FRINGED_X_OPTIONS={options}\n")
    fringed.machine.systemctl("start", X)


def start_box(fringed: Fringed) -> str:
    """Start cameras, light and triggers; return the rig.yaml of a service that measures with them."""
    fringed.write("/etc/fringed/box.yaml", yaml.safe_dump(OPTIONS))
    properties = [f"--property=Environment={key}={value}" for key, value in _ENVIRONMENT.items()]
    fringed.machine.run(
        "systemd-run", "--quiet", "--collect", f"--unit={BOX}", "--property=User=fringed", "--property=Group=fringed",
        f"--property=RuntimeDirectory={Path(FOLDER).name}", *properties,
        "/opt/fringed/env/bin/python", "-P", "-m", "sim.box", "--config", "/etc/fringed/box.yaml",
    )  # fmt: skip
    try:
        wait_until(
            lambda: any("ready:" in str(line.get("MESSAGE")) for line in fringed.machine.journal(BOX)),
            WAIT_S,
            BOX,
            poll_s=POLL_S,
        )
    except Exception as error:
        raise AssertionError(f"{error}\n{fringed.machine.tail(BOX)}") from None
    data = yaml.safe_load((fringed.machine.root / f"{FOLDER[1:]}/rig.yaml").read_text())
    data |= {key: f"{FOLDER}/{data[key]}" for key in ("calibration", "pattern", "volume")}
    data["stream"] = {"endpoints": ["ipc:///run/fringed/stream"]}
    data["control"] = {"endpoint": "ipc:///run/fringed/control"}
    data["recording"] = {"dir": "/var/lib/fringed/takes", "min_free_mb": 1}
    data["selfcheck"] = {"dir": "/var/lib/fringed/selfcheck"}
    return yaml.safe_dump(data, sort_keys=False)


def plug(fringed: Fringed, number: int, where: str) -> None:
    """Unplug a camera (``out``), or plug it in (``in``)."""
    fringed.machine.python("-m", "tests.nspawn.plug", GENTL, str(number), where)
