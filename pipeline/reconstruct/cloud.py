"""Result of a reconstruction: an organised point cloud."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.reconstruct.consistency import Consistency


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """A metric point cloud, organised on the left camera's raw pixel grid.

    Args:
        xyz: (H, W, 3) float32, mm, world frame; NaN where invalid.
        sigma_mm: (H, W) float32, one standard deviation along the viewing ray; NaN where invalid.
        gray: (H, W) uint8, the fringe-free texture, everywhere.
        modulation: two (H, W) uint8, fringe amplitude in counts of the left and of the right image.
        order: (H, W) int16, fringe order of the left pixel; -1 where invalid.
        saturated: share of saturated pixels, left and right.
        moved: lit pixels whose images contradict each other because the scene moved, of the camera with more of
            them; sets only.
        consistency: of the pair with the calibration; None = not judged.
        ms: milliseconds by stage, by the caller's clock (empty without a clock).
        rgb: (H, W, 3) uint8, the fringe-free colour, everywhere; None = not computed.
        normals: (H, W, 3) float32, unit vectors towards the camera, NaN where unknown; None = not computed.
        interpolated: (H, W) bool, points that were not measured but filled in; None = there are none.
    """

    xyz: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    gray: NDArray[np.uint8]
    modulation: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    order: NDArray[np.int16]
    saturated: tuple[float, float] = (0.0, 0.0)
    moved: int = 0
    consistency: Consistency | None = None
    ms: dict[str, float] = field(default_factory=dict)
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None
    interpolated: NDArray[np.bool_] | None = None

    @property
    def points(self) -> int:
        """Number of valid points."""
        return int(np.count_nonzero(np.isfinite(self.xyz[..., 2])))

    def withheld(self) -> Cloud:
        """The same cloud without a point."""
        unknown = np.full_like(self.xyz, np.nan)
        return replace(
            self, xyz=unknown, sigma_mm=np.full_like(self.sigma_mm, np.nan), order=np.full_like(self.order, -1)
        )
