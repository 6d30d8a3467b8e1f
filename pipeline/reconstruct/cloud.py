"""Result of a reconstruction: an organised point cloud."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from pipeline.reconstruct.consistency import Consistency
from pipeline.rig.pose import LEFT


@dataclass(frozen=True, slots=True, eq=False)
class Cloud:
    """A metric point cloud, organised on the left camera's raw pixel grid, or on that grid downsampled.

    Args:
        xyz: (H, W, 3) float32, mm, in ``frame``; NaN where invalid.
        sigma_mm: (H, W) float32, one standard deviation along the viewing ray; NaN where invalid.
        gray: (H, W) uint8, the fringe-free texture, everywhere.
        modulation: two (H, W) uint8, fringe amplitude in counts of the left and of the right image.
        order: (H, W) int16, fringe order of the left pixel; -1 where invalid.
        saturated: share of saturated pixels, left and right.
        moved: lit pixels whose images contradict each other because the scene moved, of the camera with more of
            them; sets only.
        consistency: of the pair with the calibration; None = not judged.
        interpolated: (H, W) uint8, 1 where hole filling made the point; None without it.
        frame: name of the frame of ``xyz``.
        grid: this cloud on the left camera's pixel grid and in its frame, None = it is that itself.
        measured: the cloud before the cloud filters, None = there are none.
        ms: milliseconds by stage, by the caller's clock (empty without a clock).
        rgb: (H, W, 3) uint8, the fringe-free colour, everywhere; None = not computed.
        normals: (H, W, 3) float32, unit vectors towards the camera, NaN where unknown; None = not computed.
    """

    xyz: NDArray[np.float32]
    sigma_mm: NDArray[np.float32]
    gray: NDArray[np.uint8]
    modulation: tuple[NDArray[np.uint8], NDArray[np.uint8]]
    order: NDArray[np.int16]
    saturated: tuple[float, float] = (0.0, 0.0)
    moved: int = 0
    consistency: Consistency | None = None
    interpolated: NDArray[np.uint8] | None = None
    frame: str = LEFT
    grid: Cloud | None = None
    measured: Cloud | None = None
    ms: dict[str, float] = field(default_factory=dict)
    rgb: NDArray[np.uint8] | None = None
    normals: NDArray[np.float32] | None = None

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
