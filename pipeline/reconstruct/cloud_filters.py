"""The filters of the finished cloud in their order, those that are off left out.

Temporal fusion, noise, outliers, smoothing, hole filling, region of interest, downsampling, output frame.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import blocks
from pipeline.common.settings import LIMITS, Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.common.tile_math import TILE
from pipeline.filter.cloud import downsampling, hole_filling, point_limits, smoothing, temporal_fusion
from pipeline.filter.cloud.block_rows import BLOCKS
from pipeline.filter.cloud.noise_correlation import autocorrelation, inflation
from pipeline.filter.cloud.rigid_transform import transform
from pipeline.filter.cloud.surface_tangent import inverse_depth
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.calibration import Calibration
from pipeline.rig.pose import Pose

F32 = NDArray[np.float32]
_REGION = tuple(name for name in LIMITS if name.startswith("roi_"))


def cloud_filters(
    calibration: Calibration,
    settings: Settings,
    *,
    mosaic: bool,
    pose: Pose | None = None,
    fuse: bool = False,
    clock: Callable[[], int] | None = None,
) -> CloudFilters | None:
    """The filters that settings ask for, their kernels compiled (or loaded); None when all are off.

    Args:
        mosaic: whether the images are a mosaic; pose: into the output frame, None = the left camera's.
        fuse: whether clouds of surfaces at rest are averaged; clock: returns nanoseconds, for ``Cloud.ms``.
    """
    off = settings.noise_threshold_mm == settings.outlier_threshold_mm == settings.smoothing_sigma_px == 0
    off = off and settings.hole_filling_size == 0 and settings.downsampling == 1 and not _has_region(settings)
    if off and pose is None and not fuse:
        return None
    made = CloudFilters(calibration, settings, mosaic=mosaic, pose=pose, fuse=fuse, clock=clock)
    made.warm_up()
    return made


def _has_region(settings: Settings) -> bool:
    default = Settings()
    return any(getattr(settings, name) != getattr(default, name) for name in _REGION)


class CloudFilters:
    """Arguments as of :func:`cloud_filters`. Only temporal fusion has a state; not for use from two threads at once."""

    def __init__(
        self, calibration: Calibration, settings: Settings, *, mosaic: bool, pose: Pose | None, fuse: bool,
        clock: Callable[[], int] | None,
    ) -> None:  # fmt: skip
        s = self._settings = settings
        self._pose, self._fuse, self._clock = pose, fuse, clock
        self._shape = calibration.left.size[::-1]
        correlation = autocorrelation(*s.window(mosaic=mosaic))
        if s.smoothing_sigma_px > 0:
            self._weights = smoothing.kernel(s.smoothing_sigma_px)
            self._smoothed = np.float32(inflation(self._weights.astype(np.float64), correlation))
        n = s.downsampling
        counts = np.arange(n * n + 1)
        whole = inflation(np.ones((n, n)), correlation) if n > 1 else 1.0
        # Of fewer points less: those of a full block are the nearest to each other.
        self._reduced = (1 + (whole - 1) * np.maximum(counts - 1, 0) / max(n * n - 1, 1)).astype(np.float32)
        self._rays = calibration.left.rays().astype(np.float32) if s.hole_filling_size > 0 else None
        self._box = np.array([getattr(s, f"roi_{k}_{end}_mm") for k in "xyz" for end in ("min", "max")], np.float32)
        self._rectangle = np.array([s.roi_column_min, s.roi_column_max, s.roi_row_min, s.roi_row_max])
        self._region = _has_region(s)
        self.restart()

    def restart(self) -> None:
        """Forget all former clouds."""
        if self._fuse:
            self._depth, self._variance = (np.full(self._shape, np.nan, np.float32) for _ in range(2))

    def warm_up(self) -> None:
        """Compile (or load) the kernels of the filters that are on; leaves no trace in the results."""
        unknown = np.full(self._shape, np.nan, np.float32)
        gray = np.zeros(self._shape, np.uint8)
        xyz = np.full((*self._shape, 3), np.nan, np.float32)
        self.apply(Cloud(xyz, unknown, gray, (gray, gray), np.full(self._shape, -1, np.int16)))
        self.restart()

    def apply(self, cloud: Cloud, *, stride: int = 1) -> Cloud:
        """The filtered cloud; ``cloud`` itself stays as it is and becomes ``measured``.

        Args:
            stride: only every n-th pixel of every n-th row of the cloud has a point.
        """
        s, watch = self._settings, Stopwatch(self._clock)
        xyz, sigma = cloud.xyz[::stride, ::stride].copy(), cloud.sigma_mm[::stride, ::stride].copy()
        rows = len(sigma)
        if self._fuse:
            self._average(xyz, sigma)
        if s.noise_threshold_mm > 0:
            point_limits.noise_limit(rows, np.float32(s.noise_threshold_mm), xyz, sigma)
        if s.outlier_threshold_mm > 0:
            alone, count = np.empty(sigma.shape, np.uint8), np.empty(rows, np.int64)
            bands = blocks(rows, point_limits.ROWS)
            point_limits.isolated_points(bands, xyz.reshape(rows, -1), np.float32(s.outlier_threshold_mm), alone, count)
            point_limits.reject(rows, alone, count, xyz, sigma)
        if s.smoothing_sigma_px > 0:
            self._smooth(xyz, sigma)
        filled = None
        if self._rays is not None:
            filled = np.zeros(sigma.shape, np.uint8)
            rays, size = np.ascontiguousarray(self._rays[::stride, ::stride]), s.hole_filling_size // stride
            hole_filling.fill_holes(rows, *_inverse(xyz, sigma), rays, size, xyz, sigma, filled)
        if self._region:
            self._cut(xyz, sigma, stride)
            if filled is not None:
                filled[np.isnan(sigma)] = 0
        order = cloud.order
        if stride == 1 and (self._region or s.noise_threshold_mm > 0 or s.outlier_threshold_mm > 0):
            order = np.where(np.isnan(sigma), np.int16(-1), order)
        grid = _spread(replace(cloud, order=order), xyz, sigma, filled, stride)
        out = grid
        if s.downsampling > 1:
            out = self._downsampled(grid)
        if self._pose is not None:
            out = replace(out, xyz=_posed(out.xyz, self._pose), frame=self._pose.frame)
        watch.lap("cloud filters")
        return replace(out, measured=cloud, grid=None if out is grid else grid, ms=cloud.ms | watch.ms)

    def texture(self, values: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Values (H, W) or (H, W, 3) of the camera's pixels on the grid of the filtered clouds."""
        n = self._settings.downsampling
        return values if n == 1 else _block_means(values, n)

    def _average(self, xyz: F32, sigma: F32) -> None:
        """Fuse with the clouds before; those of another stride are forgotten."""
        if self._depth.shape != sigma.shape:
            self._depth, self._variance = (np.full(sigma.shape, np.nan, np.float32) for _ in range(2))
        tiles = tuple(blocks(size, temporal_fusion.TILE) for size in sigma.shape)
        moving, rest = np.zeros(tiles, np.uint8), np.zeros((tiles[0], 2))
        flat = xyz.reshape(-1), sigma, self._depth.reshape(-1), self._variance.reshape(-1)
        temporal_fusion.find_motion(tiles[0], *flat, moving, rest)
        squares, count = rest.sum(axis=0)
        # Errors that are the same in every cloud, as of coloured textures and of the calibration, are not averaged.
        noisy = np.float32(min(squares / count, 1.0) if count else 1.0)
        temporal_fusion.fuse(tiles[0], self._settings.fusion_clouds, noisy, moving, *flat)

    def _smooth(self, xyz: F32, sigma: F32) -> None:
        rows, columns = sigma.shape
        margin = len(self._weights) // 2
        weights = np.pad(self._weights, ((0, 0), (0, -len(self._weights) % smoothing.TOGETHER)))
        pitch = blocks(columns, TILE) * TILE + weights.shape[1]
        q, variance = _inverse(xyz, sigma, margin=margin, columns=pitch)
        smoothing.smooth(
            rows, q.ravel(), variance.ravel(), np.uint64(pitch), weights, self._smoothed, xyz.reshape(rows, -1), sigma
        )  # fmt: skip

    def _cut(self, xyz: F32, sigma: F32, stride: int) -> None:
        first, last = -(-self._rectangle[::2] // stride), self._rectangle[1::2] // stride
        rectangle = np.array([first[0], last[0], first[1], last[1]])
        pose = self._pose or Pose()
        point_limits.outside_region(len(sigma), pose.matrix, self._box, rectangle, xyz, sigma)

    def _downsampled(self, cloud: Cloud) -> Cloud:
        """Blocks of n x n pixels as one; rows and columns that are left over are left out."""
        n = self._settings.downsampling
        height, width = (size // n for size in cloud.sigma_mm.shape)
        xyz, sigma = np.empty((height, width, 3), np.float32), np.empty((height, width), np.float32)
        interpolated = np.empty((height, width), np.uint8)
        filled = cloud.interpolated if cloud.interpolated is not None else np.empty((0, 0), np.uint8)
        q, variance = _inverse(
            cloud.xyz,
            cloud.sigma_mm,
            margin=n,
            columns=n * (blocks(width, BLOCKS) * BLOCKS + 2),
        )
        downsampling.downsample(
            height, n, q.reshape(-1), variance.reshape(-1), np.uint64(q.shape[1]), cloud.xyz.reshape(-1),
            cloud.sigma_mm, filled, self._reduced, xyz.reshape(height, -1), sigma, interpolated,
        )  # fmt: skip
        middle = slice(n // 2, n * height, n), slice(n // 2, n * width, n)
        left, right = cloud.modulation
        return replace(
            cloud,
            xyz=xyz,
            sigma_mm=sigma,
            gray=self.texture(cloud.gray),
            modulation=(self.texture(left), right),
            order=np.where(np.isnan(sigma), np.int16(-1), cloud.order[middle]),
            interpolated=interpolated if cloud.interpolated is not None else None,
        )


def _posed(xyz: F32, pose: Pose) -> F32:
    """Points (h, w, 3) in the pose's frame."""
    moved, rows = np.empty_like(xyz), len(xyz)
    transform(rows, pose.matrix, xyz.reshape(rows, -1), moved.reshape(rows, -1))
    return moved


def _inverse(xyz: F32, sigma: F32, *, margin: int = 0, columns: int = 0) -> tuple[F32, F32]:
    """Inverse depth and its variance; with a margin all around, and so many columns in all, NaN beside the cloud."""
    rows = len(sigma)
    shape = (rows + 2 * margin, columns) if margin > 0 else sigma.shape
    q, variance = (np.full(shape, np.nan, np.float32) if margin > 0 else np.empty(shape, np.float32) for _ in range(2))
    inverse_depth(rows, xyz.reshape(rows, -1), sigma, margin, q, variance)
    return q, variance


def _spread(cloud: Cloud, xyz: F32, sigma: F32, filled: NDArray[np.uint8] | None, stride: int) -> Cloud:
    """The cloud with the points of every n-th pixel of every n-th row."""
    if stride == 1:
        return replace(cloud, xyz=xyz, sigma_mm=sigma, interpolated=filled)
    whole, spread = np.full_like(cloud.xyz, np.nan), np.full_like(cloud.sigma_mm, np.nan)
    whole[::stride, ::stride], spread[::stride, ::stride] = xyz, sigma
    order = np.where(np.isnan(spread), np.int16(-1), cloud.order)
    marks = None
    if filled is not None:
        marks = np.zeros(spread.shape, np.uint8)
        marks[::stride, ::stride] = filled
    return replace(cloud, xyz=whole, sigma_mm=spread, order=order, interpolated=marks)


def _block_means(plane: NDArray[np.uint8], n: int) -> NDArray[np.uint8]:
    """Means of blocks of n x n values (H, W) or (H, W, 3), rounded."""
    height, width = (size // n for size in plane.shape[:2])
    sums = np.zeros((height, width, *plane.shape[2:]), np.uint16)
    for i in range(n):
        for j in range(n):
            sums += plane[i : n * height : n, j : n * width : n]
    return ((sums + n * n // 2) // (n * n)).astype(np.uint8)
