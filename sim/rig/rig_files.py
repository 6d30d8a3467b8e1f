"""The files of a calibrated simulated rig, as plain mappings of the file formats."""

from __future__ import annotations

from typing import Any

from pipeline.rig.calibration import to_mapping
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics


def calibration_mapping(layout: RigLayout, optics: Optics) -> dict[str, Any]:
    """The mapping of ``calibration.yaml``, with the calibration errors of ``optics``."""
    mapping = to_mapping(layout.calibration_for(optics))
    for side in ("left", "right"):
        mapping["cameras"][side]["serial"] = f"sim-{side}"
    return mapping | {"created": "2026-01-01T00:00:00Z", "quality": {"source": "simulated rig"}}


def pattern_mapping(layout: RigLayout) -> dict[str, Any]:
    """The object of ``pattern.json``."""
    return layout.pattern().as_mapping()


def volume_mapping(layout: RigLayout) -> dict[str, float]:
    """The object of ``volume.json``."""
    volume = layout.volume()
    return {"near_mm": volume.near_mm, "far_mm": volume.far_mm}
