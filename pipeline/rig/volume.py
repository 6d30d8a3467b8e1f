"""The measuring volume."""

from __future__ import annotations

from dataclasses import dataclass

from pipeline.common.errors import PipelineError


@dataclass(frozen=True, slots=True)
class Volume:
    """Measuring volume along the left camera's z axis, mm."""

    near_mm: float
    far_mm: float

    def __post_init__(self) -> None:
        if not 0 < self.near_mm < self.far_mm < float("inf"):
            raise PipelineError(f"volume {self.near_mm} .. {self.far_mm} mm: need 0 < near_mm < far_mm")

    def widened(self, margin: float) -> Volume:
        """The volume with its far limit times 1 + margin, its near limit times 1 - margin / 5."""
        return Volume(self.near_mm * (1 - margin / 5), self.far_mm * (1 + margin))
