"""The table of drivers: names in rig.yaml and the functions that open the devices, imported when used."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from daemon.common.errors import DaemonError

RIGS: dict[str, str] = {
    "sim": "sim.devices.open_rig:open_rig",
}
"""Whole rigs: a function of the options that returns cameras, projector, calibration, pattern and volume."""

SIM_OPTIONS = "sim.devices.options:from_mapping"
"""The check of the simulated rig's options, which renders nothing."""

CAMERAS: dict[str, str] = {
    "genicam": "drivers.genicam:open_camera",
    "v4l2": "drivers.v4l2:open_camera",
}
"""Cameras: a function of side, options and base directory that returns a closed camera."""

PROJECTORS: dict[str, str] = {
    "x11": "drivers.projector:open_projector",
    "external": "drivers.projector:open_external",
}
"""Projectors: a function of options and base directory that returns a closed projector."""


def load(target: str) -> Callable[..., Any]:
    """Import and return the function ``module:function``."""
    module, _, name = target.partition(":")
    try:
        function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise DaemonError(f"the driver {target} cannot be loaded: {error}") from error
    return function
