"""The table of drivers: a name in rig.yaml, and the function that opens such a rig, imported only when it is named."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from daemon.common.errors import DaemonError

RIGS: dict[str, str] = {
    "sim": "sim.devices.open_rig:open_rig",
}
"""Whole rigs: a function of the options that gives both cameras, the projector and what they know of themselves."""

SIM_OPTIONS = "sim.devices.options:from_mapping"
"""What checks the options of the simulated rig without rendering anything."""

CAMERAS: dict[str, str] = {
    "genicam": "drivers.genicam:open_camera",
    "v4l2": "drivers.v4l2:open_camera",
}
"""Cameras: a function of side, options and base directory that gives one, closed."""

PROJECTORS: dict[str, str] = {
    "x11": "drivers.projector:open_projector",
    "external": "drivers.projector:open_external",
}
"""Projectors: a function of options and base directory that gives one, closed."""


def load(target: str) -> Callable[..., Any]:
    """The function behind ``module:function``."""
    module, _, name = target.partition(":")
    try:
        function: Callable[..., Any] = getattr(importlib.import_module(module), name)
    except (ImportError, AttributeError) as error:
        raise DaemonError(f"the driver {target} cannot be loaded: {error}") from error
    return function
