"""Settings of the reconstruction; the defaults serve simulated and real images."""

from __future__ import annotations

import dataclasses
import difflib
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
    texture_weight: float = 1.5
    """Weight of the texture difference in the cost."""
    switch_penalty: float = 1.2
    """Cost of a jump of the absolute order between neighbours."""
    follow_cost: float = 0.15
    """Cost up to which the order expected from the last pair is taken without a search (live streams only)."""
    search_margin: float = 0.25
    """How far fringe orders are searched beyond the volume: its far limit is multiplied by 1 + this, its near one by
    1 - a fifth of this. Surfaces there get their own orders, and no points, instead of wrong orders inside. 0 = off."""
    max_check: float = 1.5
    """Largest difference of left and right absolute phase."""
    max_residual: float = 0.5
    """Largest deviation of the projector's phase from its neighbourhood."""
    max_phase_error: float = 1.0
    """Largest deviation of a point's phase from the projector's phase there, after self-calibration."""
    min_component: int = 120
    """Smallest connected component, pixels."""
    max_surface_error: float = 0.2
    """Largest rms phase error against the projector of a component that is not large."""
    edge_modulation: float = 0.65
    """Fraction of its neighbours' modulation below which a border pixel is taken as mixed."""
    self_calibrate: bool = True
    """Correct the projector columns from the first pair."""
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
                raise PipelineError(f"setting {name} is {value}, allowed {low} to {high}")

    def window(self, *, mosaic: bool) -> tuple[int, float]:
        """Radius and width of the window fit for this kind of sensor, pixels."""
        if self.window_radius >= 0:
            return max(self.window_radius, 1 if mosaic else 0), self.window_sigma
        return (2 if mosaic else 1), self.window_sigma

    def with_overrides(self, overrides: Mapping[str, object]) -> Settings:
        """A copy with some values changed; an unknown name or a wrong type raises PipelineError."""
        fields = {f.name: f for f in dataclasses.fields(self)}
        values: dict[str, object] = {}
        for name, value in overrides.items():
            if name not in fields:
                near = difflib.get_close_matches(name, fields, n=1)
                hint = f"; did you mean {near[0]}?" if near else f"; known: {', '.join(fields)}"
                raise PipelineError(f"there is no setting {name!r}{hint}")
            values[name] = _coerced(name, value, getattr(self, name))
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
    "max_check": (0.1, 3.1),
    "max_residual": (0.05, 3.1),
    "max_surface_error": (0.02, 3.1),
    "edge_modulation": (0, 1),
    "max_phase_error": (0.1, 3.1),
    "min_component": (1, 100_000),
    "self_calibration_range": (0, 8),
    "read_noise": (0, 50),
    "noise_gain": (0, 10),
}


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
