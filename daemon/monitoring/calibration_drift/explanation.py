"""Explanations of drift, as sentences."""

from __future__ import annotations

from collections.abc import Mapping

from daemon.monitoring.calibration_drift.verdicts import SURFACE, Assessment
from pipeline.monitor import OBSERVABLES
from pipeline.monitor.explain import Rotation

_GEOMETRY = ("column", "slope", "epipolar")
_NAMES = {
    "column_px": "trinocular residual",
    "column_x_px": "trinocular residual at the left and right edge",
    "column_y_px": "trinocular residual at the top and bottom edge",
    "epipolar_px": "epipolar residual",
}


def describe(drifted: Mapping[str, Assessment], cause: str = "") -> str:
    """Describe everything that has drifted, with the next step; empty when nothing has.

    Args:
        cause: the device that explains the geometry best, if any does, from :func:`describe_cause`.
    """
    parts = []
    geometry = [name for name in drifted if OBSERVABLES.get(name) in _GEOMETRY]
    if geometry:
        cause = cause or "a camera, a lens or the projector has moved"
        values = ", ".join(_value(_NAMES[name], drifted[name], "px") for name in geometry)
        parts.append(f"{cause}: {values}; run fringed calibrate check, then refine or calibrate again")
    for side in ("left", "right"):
        colors = {n: f for n, f in drifted.items() if OBSERVABLES.get(n) == "color" and n.startswith(side)}
        if colors:
            name = max(colors, key=lambda n: abs(colors[n].change) + abs(colors[n].value))
            value = _value(f"phase of its {name.split('_')[1]} channel", colors[name], "rad")
            parts.append(f"the crosstalk of the {side} camera has changed: {value}; run fringed calibrate color")
        name = f"{side}_modulation"
        if name in drifted:
            now = drifted[name]
            parts.append(
                f"fringes of the {side} image: modulation {now.value:.2f} of the mean, was "
                f"{now.value - now.change:.2f}; check focus, ambient light and exposure"
            )
    if SURFACE in drifted:
        parts.append(
            f"only {100 * drifted[SURFACE].value:.0f} % of the pixels with fringes give points: everything is outside "
            "the measuring volume, or a camera or the projector was moved far; run fringed calibrate check"
        )
    return "; ".join(parts)


def describe_cause(rotation: Rotation | None) -> str:
    """Describe the device that has moved, as a clause; empty when there is none."""
    if rotation is None:
        return ""
    device = "projector" if rotation.device == "projector" else f"{rotation.device} camera"
    axis = "xyz"[max(range(3), key=lambda k: abs(rotation.angle_deg[k]))]
    size = max(abs(value) for value in rotation.angle_deg)
    return f"the {device} or its lens has moved, as much as a turn of {size:.3f} degrees about its {axis} axis"


def _value(name: str, now: Assessment, unit: str) -> str:
    if abs(now.change) > now.limit:
        return f"{name} {now.value:+.3f} {unit}, changed by {now.change:+.3f}, limit {now.limit:.3f}"
    return f"{name} {now.value:+.2f} {unit}, which this calibration does not explain"
