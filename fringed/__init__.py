"""Receive metric point clouds from a fringed daemon.

    from fringed import subscribe

    for cloud in subscribe("tcp://rig:5555"):
        print(cloud.header.seq, cloud.xyz.shape)

Modules are imported when a name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fringed.client import ReceivedCloud, asubscribe, subscribe
    from fringed.cloud_store import StoredCloud, StoredClouds, open_clouds
    from fringed.errors import FringedError, KeyFileError, SilenceError, WireError
    from fringed.keys import Keys

__all__ = [
    "FringedError",
    "KeyFileError",
    "Keys",
    "ReceivedCloud",
    "SilenceError",
    "StoredCloud",
    "StoredClouds",
    "WireError",
    "asubscribe",
    "open_clouds",
    "subscribe",
]

_MODULES = {
    "FringedError": "fringed.errors",
    "KeyFileError": "fringed.errors",
    "Keys": "fringed.keys",
    "ReceivedCloud": "fringed.client",
    "SilenceError": "fringed.errors",
    "StoredCloud": "fringed.cloud_store",
    "StoredClouds": "fringed.cloud_store",
    "WireError": "fringed.errors",
    "asubscribe": "fringed.client",
    "open_clouds": "fringed.cloud_store",
    "subscribe": "fringed.client",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used; ``__version__`` is that of the installed distribution."""
    if name == "__version__":
        return _version()
    if name not in _MODULES:
        raise AttributeError(f"module 'fringed' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_MODULES[name]), name)
    globals()[name] = value
    return value


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("fringed")
    except PackageNotFoundError:
        return "unknown"


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted([*__all__, "__version__"])
