"""Ground truth of a rendered image, pixel by pixel."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.camera_model import CameraModel
from sim.render.lens import packed, pixel_rays, pixels_of
from sim.scene.ray_hits import Surfaces

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """Truth of one camera at the middle of the exposure, at each pixel's centre.

    Args:
        xyz: (H, W, 3) float32, mm, world; NaN where the pixel's ray hits nothing.
        projector: (H, W, 2) float32, projector pixel (u, v) that lights the point, shadow or not; NaN likewise.
        order: (H, W) int16, fringe order floor(phase / 2 pi); -1 without a hit or pattern, or outside the image.
        lit: (H, W), the projector sees the point and it lies within its image.
        seen_by_both: (H, W), the other camera sees it too, within its image.
    """

    xyz: NDArray[np.float32]
    projector: NDArray[np.float32]
    order: NDArray[np.int16]
    lit: Bools
    seen_by_both: Bools

    @property
    def hit(self) -> Bools:
        """Pixels whose ray hits a surface, (H, W)."""
        return np.asarray(np.isfinite(self.xyz[..., 2]))

    @property
    def scorable(self) -> Bools:
        """Pixels that can be measured: lit, and seen by both cameras, (H, W)."""
        return self.lit & self.seen_by_both

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """All arrays by name."""
        return {item.name: getattr(self, item.name) for item in fields(self)}


def inside(pixels: Array, size: tuple[int, int]) -> Bools:
    """Which pixels (..., 2) lie in an image of (width, height)."""
    u, v = pixels[..., 0], pixels[..., 1]
    with np.errstate(invalid="ignore"):
        return np.asarray((u >= -0.5) & (v >= -0.5) & (u <= size[0] - 0.5) & (v <= size[1] - 0.5))


def rows_of_truth(
    surfaces: Surfaces,
    camera: CameraModel,
    other: CameraModel,
    projector: CameraModel,
    pattern: ColorFringe | None,
    first_row: int,
    rows: int,
) -> Truth:
    """The truth of a band of rows."""
    width = camera.size[0]
    rays = pixel_rays(packed(camera), first_row, rows, width, 1.0, 0.0, 0.0)
    hits = surfaces.hits(camera.centre, rays)
    light = pixels_of(packed(projector), hits.points)
    lit = surfaces.visible_from(hits, projector.centre) & inside(light, projector.size)
    both = surfaces.visible_from(hits, other.centre) & inside(pixels_of(packed(other), hits.points), other.size)
    light[hits.which < 0] = np.nan
    shape = (rows, width)
    return Truth(
        hits.points.reshape(*shape, 3).astype(np.float32),
        light.reshape(*shape, 2).astype(np.float32),
        orders(light, pattern).reshape(shape),
        lit.reshape(shape),
        both.reshape(shape),
    )


def phases(projector_pixels: Array, pattern: ColorFringe) -> Array:
    """Absolute phase of projector pixels, (..., 2) -> (...), radians; NaN outside the image."""
    along = projector_pixels[..., 0] if pattern.axis == "x" else projector_pixels[..., 1]
    table = pattern.phase
    columns = np.arange(-1.0, pattern.length + 1)
    ends = np.concatenate([[2 * table[0] - table[1]], table, [2 * table[-1] - table[-2]]])
    phase = np.interp(along, columns, ends)
    with np.errstate(invalid="ignore"):
        return np.where((along >= -0.5) & (along <= pattern.length - 0.5), phase, np.nan)


def orders(projector_pixels: Array, pattern: ColorFringe | None) -> NDArray[np.int16]:
    """Fringe orders of projector pixels, -1 outside the image."""
    if pattern is None:
        return np.full(projector_pixels.shape[:-1], -1, np.int16)
    phase = phases(projector_pixels, pattern)
    return np.where(np.isfinite(phase), np.floor(np.nan_to_num(phase) / (2 * np.pi)), -1).astype(np.int16)


def stacked(bands: list[Truth]) -> Truth:
    """Bands of rows joined into one truth."""
    return Truth(*(np.concatenate([getattr(band, item.name) for band in bands]) for item in fields(Truth)))
