"""The layout of the viewer: the cloud, images at the right, plots below, panels collapsed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from daemon.apps.viewer.rerun_import import rerun

CLOUD = "world/cloud"
IMAGES = {"left": "left", "right": "right", "overlay": "modulation"}
"""Parts of a ``preview`` message and their names in the viewer."""
PLOTS = {"rate_hz": "clouds/s", "latency_ms": "latency, ms", "points": "points", "drops": "drops"}
CLOUD_WIDTH, CLOUD_HEIGHT = 0.7, 0.75
"""Share of the window for the 3D view, from the upper left corner."""


@dataclass(frozen=True, slots=True)
class Extent:
    """The extent of 96 % of the points: centre and half width along each axis, mm."""

    center: tuple[float, float, float]
    half: tuple[float, float, float]


def blueprint(extent: Extent | None = None) -> Any:
    """The layout.

    Args:
        extent: of the cloud; the eye is placed in front of it, slightly to the side and above.
    """
    rr = rerun()
    import rerun.blueprint as rrb

    eye = rrb.EyeControls3D(**_eye(extent)) if extent is not None else None
    cloud = rrb.Spatial3DView(
        origin="world", contents=[f"/{CLOUD}"], name="cloud", line_grid=False, background=[24, 26, 30], eye_controls=eye
    )
    images = [rrb.Spatial2DView(origin=f"images/{name}", name=name) for name in IMAGES.values()]
    plots = [
        rrb.TimeSeriesView(
            origin=f"figures/{name}",
            name=title,
            plot_legend=rrb.PlotLegend(visible=False),
            axis_x=_last_minute(rr, rrb),
        )
        for name, title in PLOTS.items()
    ]
    upper = rrb.Horizontal(cloud, rrb.Vertical(*images), column_shares=[CLOUD_WIDTH, 1 - CLOUD_WIDTH])
    return rrb.Blueprint(
        rrb.Vertical(upper, rrb.Horizontal(*plots), row_shares=[CLOUD_HEIGHT, 1 - CLOUD_HEIGHT]),
        rrb.TimePanel(state="collapsed", timeline="exposure", play_state="following"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        collapse_panels=True,
    )


def _last_minute(rr: Any, rrb: Any) -> Any:
    start, end = (rr.TimeRangeBoundary.cursor_relative(seconds=seconds) for seconds in (-60.0, 0.0))
    return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=end))


def _eye(extent: Extent) -> dict[str, Any]:
    """Position, target and up of the eye, mm."""
    x, y, z = extent.center
    reach = 1.75 * max(extent.half[0], extent.half[1], 1.0)
    return {
        "position": [x + 0.45 * reach, y - 0.35 * reach, z - reach],
        "look_target": [x, y, z],
        "eye_up": [0.0, -1.0, 0.0],
    }
