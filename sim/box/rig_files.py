"""The rig files of a box, for `fringed run`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from drivers.protocols import SIDES, Side
from sim.rig import rig_files
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics


@dataclass(frozen=True, slots=True)
class RigAddresses:
    """Addresses of a rig's devices.

    Args:
        producer: the GenTL producer, a .cti file; serials: of the two cameras.
        display, output: of the projector.
    """

    producer: Path
    serials: Mapping[Side, str]
    display: str
    output: str


def write_rig(
    folder: Path,
    layout: RigLayout,
    optics: Optics,
    places: RigAddresses,
    *,
    pixel_format: str,
    exposure_us: float,
    tolerance_us: float = 1_000.0,
    tcp: int = 0,
    extra: Mapping[str, Any] | None = None,
) -> Path:
    """Write rig.yaml, calibration.yaml, pattern.json and volume.json, for a layout; returns the path of the first.

    Args:
        folder: created if missing; the sockets of stream and control lie there too.
        layout: with the devices' sizes; optics: determine the calibration's colours and response.
        pixel_format: of the cameras, by its name in GenICam (``RGB8``, ``BayerRG8``, ...).
        exposure_us: of the cameras; tolerance_us: of the pairing.
        tcp: port of the stream in addition to its socket; 0 = none.
        extra: further sections of rig.yaml; they come last and replace those of the same name.
    """
    folder.mkdir(parents=True, exist_ok=True)
    calibration = rig_files.calibration_mapping(layout, optics)
    for side in SIDES:
        calibration["cameras"][side]["serial"] = places.serials[side]
    (folder / "calibration.yaml").write_text(yaml.safe_dump(calibration, sort_keys=False))
    (folder / "pattern.json").write_text(json.dumps(rig_files.pattern_mapping(layout), indent=1))
    (folder / "volume.json").write_text(json.dumps(rig_files.volume_mapping(layout), indent=1))
    width, height = layout.camera_size
    cameras = {
        side: {
            "producer": str(places.producer),
            "serial": places.serials[side],
            "exposure_us": exposure_us,
            "pixel_format": pixel_format,
            "trigger": {"line": "Line1"},
        }
        for side in SIDES
    }
    rig: dict[str, Any] = {
        "device": {"name": "box"},
        "cameras": {"driver": "genicam", **cameras},
        "projector": {"driver": "x11", "options": {"output": places.output, "display": places.display}},
        "calibration": "calibration.yaml",
        "pattern": "pattern.json",
        "volume": "volume.json",
        "pairing": {"tolerance_us": tolerance_us},
        "stream": {"endpoints": [f"ipc://{folder}/stream", *([f"tcp://127.0.0.1:{tcp}"] if tcp else [])]},
        "control": {"endpoint": f"ipc://{folder}/control"},
    }
    path = folder / "rig.yaml"
    header = f"# A rig on emulated hardware: {width} x {height} pixels a camera, written by sim.box\n"
    path.write_text(header + yaml.safe_dump(rig | dict(extra or {}), sort_keys=False))
    return path


PIXEL_FORMATS = {
    "rgb8": "RGB8",
    "bayer_rggb8": "BayerRG8",
    "bayer_bggr8": "BayerBG8",
    "bayer_grbg8": "BayerGR8",
    "bayer_gbrg8": "BayerGB8",
    "mono8": "Mono8",
    "mono16": "Mono16",
}
"""GenICam's names of the encodings."""
