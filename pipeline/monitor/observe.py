"""Observation of a rig from one ordinary pair: a few numbers, each with its standard deviation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.parallel_for import blocks
from pipeline.common.settings import Settings
from pipeline.decode.raw_image import checked, mosaic_of
from pipeline.geometry.ray_tables import DepthScale, packed, period_in_image
from pipeline.monitor import sensitivity, texture_disparity
from pipeline.monitor.brightness import TEXTURE
from pipeline.monitor.lock_in import LIGHT
from pipeline.monitor.patches import GROUP, SHAPE, measure_group, measure_patches
from pipeline.monitor.robust import fit, means
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud import Cloud
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

F64 = NDArray[np.float64]

SIDES = ("left", "right")
COLORS = ("red", "green", "blue")
_ROWS = 16
_LEAST_PATCHES = 24
_DRAWS = 8
"""How often patches are chosen at most."""
_SURFACE_PX = 0.02  # variation of the epipolar residual from scene to scene by slopes and textures alone


@dataclass(frozen=True, slots=True)
class Reading:
    """A number and its standard deviation, from one pair."""

    value: float
    sigma: float


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """Observation of one pair.

    Args:
        readings: by name, only those that the scene allows; see :data:`pipeline.monitor.OBSERVABLES`.
        patches: number of surface patches used.
        shape: (n, 14) the patches' positions and slopes, see :func:`pipeline.monitor.patches.measure_patches`.
        lit: fraction of the left image with fringes; valid: fraction of those pixels that have a point.
    """

    readings: dict[str, Reading]
    patches: int
    shape: F64
    lit: float
    valid: float


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """The usable patches of one pair; columns as in :func:`pipeline.monitor.patches.measure_patches`."""

    shape: F64
    light: F64
    texture: F64
    textured: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.shape)


class Observer:
    """Measures the observables of pairs and their clouds.

    Args:
        calibration, pattern, volume, encoding: as of the reconstructor that made the clouds.
        patches: largest number of surface patches of each pair; more take longer and reduce the standard deviations.
        seed: of the random choice of patches.
        parallel: measure on numba's threads, of which no other thread may make use at the same time.
    """

    def __init__(
        self,
        calibration: Calibration,
        pattern: ColorFringe,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        patches: int = 150,
        seed: int = 0,
        parallel: bool = False,
    ) -> None:
        self.calibration, self.pattern, self.encoding = calibration, pattern, encoding
        self._settings = settings or Settings()
        self._limit, self._parallel = patches, parallel
        self._rng = np.random.default_rng(seed)
        mosaic = mosaic_of(encoding)
        self._mosaic = np.zeros((2, 2), np.int64) if mosaic is None else mosaic
        self.first = self._first = 0 if pattern.axis == "x" else 1
        depth = DepthScale.of(volume)
        period = period_in_image(calibration, depth, axis=pattern.axis, period=pattern.length / pattern.periods)
        along = 2 * max(4, round(period))
        self._size = (along, _ROWS) if self._first == 0 else (_ROWS, along)
        self._other, self._projector = packed(calibration.right), packed(calibration.projector)
        self._phases = np.asarray(pattern.phase, dtype=np.float64)
        self._black = np.stack([calibration.left_color.black, calibration.right_color.black])
        self._unmix = np.stack([calibration.left_color.unmix, calibration.right_color.unmix])
        self._turn_back = np.exp(-1j * np.array(pattern.shifts))
        self._places = self._grid()

    def _grid(self) -> NDArray[np.int64]:
        """(n, 2) column and row of every possible patch, even numbers."""
        width, height = self.calibration.left.size
        step = [2 * (side // 2) for side in self._size]
        u, v = (
            np.arange(2, side - own - 2, by) for side, own, by in zip((width, height), self._size, step, strict=True)
        )
        return np.stack([axis.ravel() for axis in np.meshgrid(u, v)], axis=1).astype(np.int64)

    def patches(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud) -> Patches:
        """The surface patches of one pair, chosen at random among those with points.

        Where less than half of them can be measured (clipped, or narrow surfaces), others are chosen.

        Raises:
            ImageError: an image of another size or type.
        """
        images = [
            checked(image, side, self.encoding, device.size).reshape(*image.shape[:2], -1)
            for image, side, device in (
                (left, "left", self.calibration.left), (right, "right", self.calibration.right)
            )
        ]  # fmt: skip
        usable, found = self._usable(cloud), []
        for _ in range(_DRAWS):
            chosen = usable
            if len(usable) > self._limit:
                chosen = np.sort(self._rng.choice(usable, self._limit, replace=False))
            usable = np.setdiff1d(usable, chosen, assume_unique=True)
            found.append(self._measured(images, cloud, self._places[chosen]))
            if len(usable) == 0 or 2 * sum(map(len, found)) >= self._limit:
                break
        return Patches(
            *(np.concatenate([getattr(one, item.name) for one in found]) for item in fields(Patches))
        )  # fmt: skip

    def _measured(self, images: Sequence[NDArray[Any]], cloud: Cloud, places: NDArray[np.int64]) -> Patches:
        """The patches at places (n, 2) that can be measured."""
        n = len(places)
        good = np.zeros(n, np.uint8)
        shape, light, sums = np.zeros((n, SHAPE)), np.zeros((n, 2, 3, LIGHT)), np.zeros((n, TEXTURE))
        arguments = (
            images[0], images[1], self._mosaic, self._black, cloud.xyz, places, *self._size, self._projector,
            self._other, self._phases, self._first, int(np.ceil(self._settings.saturation)), good, shape, light, sums,
        )  # fmt: skip
        if self._parallel:
            measure_group(blocks(n, GROUP), *arguments)
        else:
            measure_patches(*arguments)
        use = good > 0
        return Patches(shape[use], light[use], sums[use], good[use] > 1)

    def _usable(self, cloud: Cloud) -> NDArray[np.int64]:
        """Numbers of the patches whose middle and corners have points."""
        columns, rows = self._size
        z = cloud.xyz[..., 2]
        valid = np.ones(len(self._places), bool)
        for du, dv in (
            (columns // 4 * 2, rows // 4 * 2),
            (2, 2),
            (columns - 2, 2),
            (2, rows - 2),
            (columns - 2, rows - 2),
        ):
            u, v = self._places[:, 0] + du - du % 2, self._places[:, 1] + dv - dv % 2
            valid &= np.isfinite(z[v, u])
        return np.flatnonzero(valid)

    def observe(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud) -> Observation:
        """The observation of a pair and its cloud."""
        some = cloud.modulation[0][::8, ::8] >= self._settings.min_modulation
        lit = float(some.mean())
        valid = float((np.isfinite(cloud.xyz[::8, ::8, 2]) & some).sum() / max(1, int(some.sum())))
        found = self.patches(left, right, cloud)
        if len(found) < _LEAST_PATCHES:
            return Observation({}, len(found), found.shape, lit, valid)
        return Observation(self.readings(found), len(found), found.shape, lit, valid)

    def readings(self, found: Patches) -> dict[str, Reading]:
        """All readings of these patches."""
        waves = self._waves(found)
        ahead = self._ahead(waves)
        out = self._columns(found, ahead)
        out |= self._epipolar(found, out.pop("slope", None))
        out |= self._colors(found, waves, ahead)
        out |= self._modulation(found, waves)
        return out

    def residuals(self, found: Patches) -> F64:
        """(n,) observed minus predicted projector coordinate of every patch, pixels."""
        return self._residuals(found, self._ahead(self._waves(found)))

    def _ahead(self, waves: NDArray[np.complex128]) -> F64:
        """(n, 2) phase by which each image is ahead of the geometry: the mean of the channels' directions.

        Not of the channels themselves: with misregistered projector colours a red surface would be ahead of a blue one.
        """
        rotated = waves * self._turn_back
        return np.asarray(np.angle((rotated / np.maximum(np.abs(rotated), 1e-6)).sum(axis=2)))

    def _residuals(self, found: Patches, ahead: F64) -> F64:
        return np.asarray(ahead.mean(axis=1) / found.shape[:, 10])

    def _waves(self, found: Patches) -> NDArray[np.complex128]:
        """(n, 2, 3) B exp(i (r + shift)) of every camera and channel, crosstalk removed."""
        raw = found.light[..., 1] - 1j * found.light[..., 2]
        return np.asarray(np.einsum("kcp,nkp->nkc", self._unmix, raw))

    def _means(self, found: Patches) -> F64:
        """(n, 2, 3) A of every camera and channel, crosstalk removed."""
        return np.asarray(np.einsum("kcp,nkp->nkc", self._unmix, found.light[..., 0] - self._black))

    def _columns(self, found: Patches, ahead: F64) -> dict[str, Reading]:
        """Trinocular residual: observed minus predicted projector coordinate, and its change over the image."""
        residual = self._residuals(found, ahead)
        solution = fit(sensitivity.design(self.calibration, found.shape, self._first), residual)
        if solution is None:
            return {}
        names = ("column_px", "column_x_px", "column_y_px", "slope")
        return {name: Reading(float(v), float(s)) for name, v, s in zip(names, *solution, strict=True)}

    def _epipolar(self, found: Patches, slope: Reading | None) -> dict[str, Reading]:
        """Displacement across the epipolar lines: from fringe slopes and texture, combined."""
        readings = [] if slope is None else [slope]
        use = found.textured
        if use.sum() >= _LEAST_PATCHES:
            x, y = sensitivity.in_image(self.calibration, found.shape[use, :3])
            displaced = texture_disparity.displacement(found.texture[use], x, y, across=1 - self._first)
            readings += [] if displaced is None else [Reading(float(displaced[0][0]), float(displaced[1][0]))]
        if not readings:
            return {}
        weights = np.array([1 / (reading.sigma**2 + _SURFACE_PX**2) for reading in readings])
        value = float(weights @ [reading.value for reading in readings] / weights.sum())
        return {"epipolar_px": Reading(value, float(weights.sum() ** -0.5))}

    def _colors(self, found: Patches, waves: NDArray[np.complex128], ahead: F64) -> dict[str, Reading]:
        """Phase of each channel against the mean of the three, in the middle of the image.

        Lateral chromatic aberration shifts channels too, in opposite directions left and right; the slopes absorb it.
        """
        x, y = sensitivity.in_image(self.calibration, found.shape[:, :3])
        design = np.stack([np.ones_like(x), x, y], axis=1)
        rotated = np.angle(waves * self._turn_back * np.exp(-1j * ahead)[:, :, None])
        out = {}
        for k, side in enumerate(SIDES):
            for c, color in enumerate(COLORS):
                solution = fit(design, rotated[:, k, c])
                if solution is not None:
                    out[f"{side}_{color}_rad"] = Reading(float(solution[0][0]), float(solution[1][0]))
        return out

    def _modulation(self, found: Patches, waves: NDArray[np.complex128]) -> dict[str, Reading]:
        """B / A of each camera."""
        mean = np.maximum(self._means(found).sum(axis=2), 1.0)
        value, sigma = means(np.abs(waves).sum(axis=2) / mean)
        return {f"{side}_modulation": Reading(float(value[k]), float(sigma[k])) for k, side in enumerate(SIDES)}


def warm_up(*, parallel: bool = False) -> None:
    """Compile (or load) the kernel by a run on empty images; ``parallel``: that on numba's threads, too."""
    image = np.zeros((8, 8, 3), np.uint8)
    image.setflags(write=False)
    device = np.zeros(22)
    nothing = np.zeros(0, np.uint8), np.zeros((0, SHAPE)), np.zeros((0, 2, 3, LIGHT)), np.zeros((0, TEXTURE))
    arguments = (
        image, image, np.zeros((2, 2), np.int64), np.zeros((2, 3)), np.zeros((8, 8, 3), np.float32),
        np.zeros((0, 2), np.int64), 8, 8, device, device, np.zeros(8), 0, 255, *nothing,
    )  # fmt: skip
    measure_patches(*arguments)
    if parallel:
        measure_group(0, *arguments)
