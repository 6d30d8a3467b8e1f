"""GenICam cameras (GigE Vision, USB3 Vision, CoaXPress...) through their vendors' GenTL producers.

Nothing here loads a vendor's library into this process: each camera, and each listing of cameras, has its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from drivers.genicam import listing
from drivers.genicam.listing import DetectedCamera
from drivers.genicam.options import parse, producers
from drivers.protocols import Camera, Side
from drivers.remote import RemoteCamera
from drivers.remote.camera import Limits

__all__ = ["DetectedCamera", "discover", "open_camera"]

_TARGET = "drivers.genicam.camera:open_alone"


def open_camera(side: Side, options: Mapping[str, Any], base_dir: Path) -> Camera:
    """Create a closed camera from the options of a rig file (see :class:`drivers.genicam.options.Options`).

    Raises:
        ValueError: invalid options; names the key.
    """
    checked = parse(side, options)
    try:
        producers(checked.producer, base_dir)
    except (ValueError, OSError) as error:
        raise ValueError(f"cameras.{side}.producer: {error}") from error
    return RemoteCamera(side, _TARGET, options, base_dir, limits=Limits(open_s=checked.open_timeout_s))


def discover(producers: Sequence[Path]) -> list[DetectedCamera]:
    """List every camera of the producers (.cti files); does not disturb one that is open."""
    return listing.discover(producers)
