"""Metric point clouds from a fringed daemon, or from a recording, with one interface.

    import fringed

    with fringed.Rig() as rig:               # or fringed.open("take.mcap")
        for cloud in rig.clouds():
            print(cloud.header.seq, cloud.points.shape)

Modules are imported when a name is first used.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fringed.errors import (
        ArgumentError,
        CodecMissingError,
        ControlError,
        FringedError,
        KeyFileError,
        NoDaemonError,
        NotLiveError,
        OverwrittenError,
        RecordingError,
        RefusedError,
        SharedMemoryError,
        SilenceError,
        WireError,
    )
    from fringed.files.cloud_store import StoredCloud, StoredClouds, open_clouds
    from fringed.keys import Keys
    from fringed.rig.live import Rig
    from fringed.rig.opening import open_source as open  # noqa: A004 - fringed.open, as gzip.open
    from fringed.rig.preview import Preview
    from fringed.rig.source import Source
    from fringed.stream.received_cloud import ReceivedCloud
    from fringed.stream.subscription import asubscribe, subscribe

__all__ = [
    "ArgumentError",
    "CodecMissingError",
    "ControlError",
    "FringedError",
    "KeyFileError",
    "Keys",
    "NoDaemonError",
    "NotLiveError",
    "OverwrittenError",
    "Preview",
    "ReceivedCloud",
    "RecordingError",
    "RefusedError",
    "Rig",
    "SharedMemoryError",
    "SilenceError",
    "Source",
    "StoredCloud",
    "StoredClouds",
    "WireError",
    "asubscribe",
    "open",
    "open_clouds",
    "subscribe",
]

_MODULES = {
    **dict.fromkeys((name for name in __all__ if name.endswith("Error")), "fringed.errors"),
    **dict.fromkeys(("asubscribe", "subscribe"), "fringed.stream.subscription"),
    **dict.fromkeys(("StoredCloud", "StoredClouds", "open_clouds"), "fringed.files.cloud_store"),
    "Keys": "fringed.keys",
    "Preview": "fringed.rig.preview",
    "ReceivedCloud": "fringed.stream.received_cloud",
    "Rig": "fringed.rig.live",
    "Source": "fringed.rig.source",
    "open": "fringed.rig.opening",
}
_NAMES = {"open": "open_source"}
"""Names inside their modules that differ from the public ones."""


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used; ``__version__`` is that of the installed distribution."""
    if name == "__version__":
        return _version()
    if name not in _MODULES:
        raise AttributeError(f"module 'fringed' has no attribute {name!r}; it has {', '.join(__all__)}")
    value = getattr(import_module(_MODULES[name]), _NAMES.get(name, name))
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
