"""Verdicts in words."""

from __future__ import annotations

from collections.abc import Mapping

from daemon.monitoring.calibration_drift.verdicts import SURFACE, Found
from pipeline.monitor import OBSERVABLES
from pipeline.monitor.explain import Turn

_GEOMETRY = ("column", "slope", "epipolar")
_NAMES = {
    "column_px": "trinocular residual",
    "column_x_px": "trinocular residual at the left and right edge",
    "column_y_px": "trinocular residual at the top and bottom edge",
    "epipolar_px": "epipolar residual",
}


def told(drifted: Mapping[str, Found], guess: str = "") -> str:
    """One sentence about everything that has drifted, with the next step; empty when nothing has.

    Args:
        guess: which device explains the geometry best, if any does.
    """
    parts = []
    geometry = [name for name in drifted if OBSERVABLES.get(name) in _GEOMETRY]
    if geometry:
        who = guess or "a camera, a lens or the projector has moved"
        what = ", ".join(_measured(_NAMES[name], drifted[name], "px") for name in geometry)
        parts.append(f"{who}: {what}; run fringed calibrate check, then refine or calibrate again")
    for side in ("left", "right"):
        colors = {n: f for n, f in drifted.items() if OBSERVABLES.get(n) == "color" and n.startswith(side)}
        if colors:
            name = max(colors, key=lambda n: abs(colors[n].change) + abs(colors[n].value))
            what = _measured(f"phase of its {name.split('_')[1]} channel", colors[name], "rad")
            parts.append(f"the crosstalk of the {side} camera has changed: {what}; run fringed calibrate color")
        name = f"{side}_modulation"
        if name in drifted:
            found = drifted[name]
            parts.append(
                f"fringes of the {side} image: modulation {found.value:.2f} of the mean, was "
                f"{found.value - found.change:.2f}; look at focus, ambient light and exposure"
            )
    if SURFACE in drifted:
        parts.append(
            f"fringes are seen, but only {100 * drifted[SURFACE].value:.0f} % of them give points: everything stands "
            "outside of the measuring volume, or a camera or the projector was moved far; run fringed calibrate check"
        )
    return "; ".join(parts)


def guess(turn: Turn | None) -> str:
    """Who has moved, as a clause."""
    if turn is None:
        return ""
    who = "projector" if turn.device == "projector" else f"{turn.device} camera"
    about = "xyz"[max(range(3), key=lambda k: abs(turn.turn_deg[k]))]
    size = max(abs(value) for value in turn.turn_deg)
    return f"the {who} or its lens has moved, as much as a turn of {size:.3f} degrees about its {about} axis"


def _measured(name: str, found: Found, unit: str) -> str:
    if abs(found.change) > found.limit:
        value, change, limit = (
            f"{number:{sign}.3f}" for number, sign in ((found.value, "+"), (found.change, "+"), (found.limit, ""))
        )
        return f"{name} {value} {unit}, changed by {change}, limit {limit}"
    return f"{name} {found.value:+.2f} {unit}, which this calibration does not explain"
