"""Settings of the reconstruction; the defaults serve simulated and real images."""

from __future__ import annotations

import dataclasses
import difflib
import warnings
from collections.abc import Mapping
from dataclasses import dataclass

from pipeline.common.errors import PipelineError


@dataclass(frozen=True, slots=True)
class Settings:
    """Scalar settings of the reconstruction; phases in radians, intensities in camera counts of the 8-bit scale."""

    min_modulation: float = 5.0
    """Fringe amplitude below which a pixel is invalid."""
    saturation: float = 254.0
    """Counts from which a sample is taken as saturated."""
    window_radius: int = -1
    """Half width of the window that the phase is fitted in, 0 (pointwise, three-chip only), 1 or 2 pixels;
    -1: 1 for three chips, 2 for a mosaic."""
    window_sigma: float = 1.0
    """Width of the Gaussian weights of that window, pixels."""
    lattice_x: int = 3
    """Step of the order search along the fringes' direction of growth, pixels."""
    lattice_y: int = 3
    """Step of the order search across it, pixels."""
    cost_sigma: float = 0.5
    """Width of the phase cost."""
    texture_weight: float = 2.5
    """Weight of the texture difference in the cost; less until the first pair is calibrated."""
    switch_penalty: float = 1.2
    """Cost of a jump of the absolute order between neighbours."""
    follow_cost: float = 0.15
    """Cost up to which the order expected from the last pair is taken without a search (live streams only)."""
    search_margin: float = 0.25
    """How far fringe orders are searched beyond the volume: its far limit is multiplied by 1 + this, its near one by
    1 - a fifth of this. Surfaces there get their own orders, and no points, instead of wrong orders inside. 0 = off."""
    consistency_threshold: float = 1.5
    """Consistency filter: largest difference of the left and the right camera's absolute phase."""
    outlier_phase_threshold: float = 0.35
    """Outlier filter: largest deviation of a point's projector phase from that of its neighbourhood."""
    reflection_threshold: float = 1.0
    """Reflection filter: largest deviation of a point's phase from the projector's phase there, after
    self-calibration; light reflected from other surfaces changes it."""
    cluster_min_area: int = 120
    """Cluster filter: area of the smallest connected component that is kept."""
    cluster_phase_threshold: float = 0.2
    """Cluster filter: largest rms phase error against the projector of a component that is not large."""
    uniqueness_ratio: float = 5.0
    """Cluster filter: least margin by which the fringe orders of a surface cost less than the second best ones,
    percent of the cost of a disagreeing pixel; down to 0.3 of it where the projector's position repeats; 0 = off."""
    edge_threshold: float = 0.65
    """Edge filter: fraction of its neighbours' modulation below which a border pixel is taken as mixed; 0 = off."""
    edge_probability: float = 0.05
    """Edge filter: largest probability that a point near the border of its surface is wrong; 1 = off."""
    outlier_threshold_mm: float = 0.0
    """Outlier filter: distance within which a point needs two of its eight neighbours; 0 = off."""
    noise_threshold_mm: float = 0.0
    """Noise filter: largest standard deviation of a point; 0 = off."""
    smoothing_sigma_px: float = 0.0
    """Smoothing: width of the Gaussian weights of the plane fit around every point, along its surface; 0 = off."""
    hole_filling_size: int = 0
    """Hole filling: widest gap inside one surface that is interpolated, along rows and columns; 0 = off."""
    roi_x_min_mm: float = -1e5
    """Region of interest: least x of the box, in the output frame."""
    roi_x_max_mm: float = 1e5
    """Region of interest: largest x of the box, in the output frame."""
    roi_y_min_mm: float = -1e5
    """Region of interest: least y of the box, in the output frame."""
    roi_y_max_mm: float = 1e5
    """Region of interest: largest y of the box, in the output frame."""
    roi_z_min_mm: float = -1e5
    """Region of interest: least z of the box, in the output frame."""
    roi_z_max_mm: float = 1e5
    """Region of interest: largest z of the box, in the output frame."""
    roi_column_min: int = 0
    """Region of interest: first column of the rectangle in the left image."""
    roi_column_max: int = 65535
    """Region of interest: last column of the rectangle in the left image."""
    roi_row_min: int = 0
    """Region of interest: first row of the rectangle in the left image."""
    roi_row_max: int = 65535
    """Region of interest: last row of the rectangle in the left image."""
    downsampling: int = 1
    """Downsampling: n x n points become their weighted mean; 1 = off."""
    fusion_clouds: int = 8
    """Temporal fusion (pipeline.temporal: fuse): most clouds that are averaged where a surface is at rest."""
    self_calibrate: bool = True
    """Correct projector columns, and white balance and contrast of the right camera, from the first pair."""
    self_calibration_range: float = 2.0
    """Largest offset of the projector columns that is searched, projector pixels."""
    read_noise: float = 0.0
    """Read noise, counts; 0 = estimate the noise from the images."""
    noise_gain: float = 0.0
    """Shot noise: variance per count; used when read_noise is given."""

    def __post_init__(self) -> None:
        for name, (low, high) in LIMITS.items():
            value = getattr(self, name)
            if not low <= value <= high:
                raise PipelineError(f"setting {name} is {value}, allowed {low:g} to {high:g}")
        for name in ("roi_x_{}_mm", "roi_y_{}_mm", "roi_z_{}_mm", "roi_column_{}", "roi_row_{}"):
            least, most = getattr(self, name.format("min")), getattr(self, name.format("max"))
            if least >= most:
                raise PipelineError(
                    f"setting {name.format('min')} is {least}, which must be less than {name.format('max')}, {most}; "
                    "exchange them or widen the region"
                )

    def window(self, *, mosaic: bool) -> tuple[int, float]:
        """Radius and width of the window fit for this kind of sensor, pixels."""
        if self.window_radius >= 0:
            return max(self.window_radius, 1 if mosaic else 0), self.window_sigma
        return (2 if mosaic else 1), self.window_sigma

    def with_overrides(self, overrides: Mapping[str, object]) -> Settings:
        """A copy with some values changed; an unknown name or a wrong type raises PipelineError.

        A name of the last release is accepted with a FutureWarning.
        """
        fields = {f.name: f for f in dataclasses.fields(self)}
        values: dict[str, object] = {}
        for name, value in overrides.items():
            now = current_name(name)
            if now not in fields:
                near = difflib.get_close_matches(name, fields, n=1)
                hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(fields)}"
                raise PipelineError(f"there is no setting {name!r}{hint}")
            if now in values:
                raise PipelineError(f"setting {now} is given twice, also by its former name; remove the former name")
            values[now] = _coerced(now, value, getattr(self, now))
        return dataclasses.replace(self, **values)  # type: ignore[arg-type]


LIMITS: dict[str, tuple[float, float]] = {
    "min_modulation": (0.5, 100),
    "saturation": (128, 256),
    "window_radius": (-1, 2),
    "window_sigma": (0.3, 5),
    "lattice_x": (1, 8),
    "lattice_y": (1, 8),
    "cost_sigma": (0.05, 3),
    "texture_weight": (0, 10),
    "switch_penalty": (0, 20),
    "follow_cost": (0, 2),
    "search_margin": (0, 1),
    "consistency_threshold": (0.1, 3.1),
    "outlier_phase_threshold": (0.05, 3.1),
    "cluster_phase_threshold": (0.02, 3.1),
    "uniqueness_ratio": (0, 100),
    "edge_threshold": (0, 1),
    "edge_probability": (0.001, 1),
    "reflection_threshold": (0.1, 3.1),
    "cluster_min_area": (1, 100_000),
    "outlier_threshold_mm": (0, 1000),
    "noise_threshold_mm": (0, 1000),
    "smoothing_sigma_px": (0, 3),
    "hole_filling_size": (0, 32),
    "roi_x_min_mm": (-1e5, 1e5),
    "roi_x_max_mm": (-1e5, 1e5),
    "roi_y_min_mm": (-1e5, 1e5),
    "roi_y_max_mm": (-1e5, 1e5),
    "roi_z_min_mm": (-1e5, 1e5),
    "roi_z_max_mm": (-1e5, 1e5),
    "roi_column_min": (0, 65535),
    "roi_column_max": (0, 65535),
    "roi_row_min": (0, 65535),
    "roi_row_max": (0, 65535),
    "downsampling": (1, 8),
    "fusion_clouds": (1, 64),
    "self_calibration_range": (0, 8),
    "read_noise": (0, 50),
    "noise_gain": (0, 10),
}


RENAMED: dict[str, str] = {
    "max_check": "consistency_threshold",
    "max_residual": "outlier_phase_threshold",
    "max_phase_error": "reflection_threshold",
    "min_component": "cluster_min_area",
    "max_surface_error": "cluster_phase_threshold",
    "edge_modulation": "edge_threshold",
}
"""Names of the last release and their present ones."""


def current_name(name: str) -> str:
    """The present name of a setting; a name of the last release gives a FutureWarning."""
    if name not in RENAMED:
        return name
    text = f"setting {name} is called {RENAMED[name]} now; the former name ends with the next release"
    warnings.warn(text, FutureWarning, stacklevel=1)
    return RENAMED[name]


def _coerced(name: str, value: object, current: object) -> object:
    if isinstance(current, bool):
        if isinstance(value, bool):
            return value
    elif isinstance(value, bool):
        pass
    elif isinstance(current, int):
        if isinstance(value, int):
            return value
    elif isinstance(value, (int, float)):
        return float(value)
    raise PipelineError(f"setting {name} takes {type(current).__name__}, got {value!r}")
