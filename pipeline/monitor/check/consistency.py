"""Consistency of one pair with the calibration, without a learned reference.

A left pixel, its match in the right image and the projector column that lights the point determine two unknowns three
times over (see :mod:`pipeline.monitor`). Patches of the surface give the residual of the projector column: its mean,
its slopes along both axes of the image and its scatter. Fringe slopes and texture give the displacement across the
epipolar lines and its change over the image. The order search gives its cost as a function of a column offset, and of a
displacement of the right image. For a rig that is as calibrated all of these are small against fixed limits that follow
from the angles a device can turn before points become wrong; the limits are in projector and camera pixels of the
standard rig and scale with the focal lengths.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.monitor import sensitivity, texture_disparity
from pipeline.monitor.check.cause import LEAST_SHARE, baseline_shares, cause_of
from pipeline.monitor.check.limits import LIMITS, SIGMAS, combined, depth_offsets, judged
from pipeline.monitor.observe import Observer, Patches
from pipeline.monitor.robust import fit, scale_of
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.consistency import ColumnScan, Consistency, Reading
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

_AGREEMENT = 3.0  # standard deviations of the difference
_LEAST_PATCHES = 16
_CLEARLY_LESS = 0.85
_AGREEMENT_GAIN = 0.005
"""Gain of :class:`pipeline.reconstruct.consistency.ColumnScan` from which some pixels agree up to noise. Where patches
agree as well, a high cost of all pixels is that of surfaces out of reach or of an unknown response, no refutation."""
_MOVED_GAIN = 0.03
"""The same below which the columns may have moved: some pixels of a scene agree at any offset. Intact rigs whose cost
is clearly less elsewhere have 0.07 and more."""
_LEAST_CHANGE_PX = 0.2
"""Columns from the correction in use to the offset that costs clearly less, one of steps of a quarter of a column."""


class ConsistencyCheck:
    """Judges pairs by their images and clouds.

    Args:
        calibration, pattern, volume, encoding, settings: as of the reconstructor that made the clouds.
        patches: largest number of surface patches of a pair; time grows with it.
    """

    def __init__(
        self,
        calibration: Calibration,
        pattern: ColorFringe,
        volume: Volume,
        *,
        encoding: str = "rgb8",
        settings: Settings | None = None,
        patches: int = 60,
    ) -> None:
        self._observer = Observer(
            calibration, pattern, volume, encoding=encoding, settings=settings, patches=patches, seed=1, parallel=True
        )
        self.calibration, self._first = calibration, self._observer.first
        focal = calibration.projector.matrix[self._first, self._first]
        self._projector_deg = float(np.degrees(1 / focal))
        self._camera_deg = float(np.degrees(1 / calibration.right.matrix[1 - self._first, 1 - self._first]))
        self._middle_mm = (volume.near_mm + volume.far_mm) / 2
        self._phase = 2 * np.pi * pattern.periods / pattern.length

    def check(self, left: NDArray[Any], right: NDArray[Any], cloud: Cloud, scan: ColumnScan | None) -> Consistency:
        """Judge a pair of raw images by its cloud, and by the column scan of this pair or of an earlier one."""
        readings = self.readings(self._observer.patches(left, right, cloud))
        if scan is not None:
            readings |= self._scanned(scan, readings) | ({} if "column_offset" in readings else self._drift(scan))
        readings["combined"] = combined(readings)
        return judged(readings, cause_of(readings, self.calibration))

    def readings(self, patches: Patches) -> dict[str, Reading]:
        """All readings that these patches show, in the units of :data:`LIMITS`."""
        if len(patches) < _LEAST_PATCHES:
            return {}
        residual = self._observer.residuals(patches)
        design = sensitivity.design(self.calibration, patches.shape, self._first)
        solution = fit(design, residual)
        if solution is None:
            return {}
        value, sigma = solution
        out = {
            name: Reading(float(value[k]) * self._projector_deg, float(sigma[k]) * self._projector_deg)
            for k, name in enumerate(("column_offset", "column_x", "column_y"))
        }
        out |= self._depth_offsets(Reading(float(value[0]), float(sigma[0])), patches.shape[:, :3])
        scatter = scale_of(residual - design @ value) * self._phase
        out["column_scatter"] = Reading(scatter, scatter / float(np.sqrt(2 * len(patches))))
        across = [(value[3], float(np.hypot(sigma[3], _PHASE_BIAS / self._phase / _independent(design, 3))))]
        use = patches.textured
        if np.count_nonzero(use) >= _LEAST_PATCHES:
            x, y = sensitivity.in_image(self.calibration, patches.shape[use, :3])
            texture = texture_disparity.displacement(patches.texture[use], x, y, across=1 - self._first)
            if texture is not None:
                across.append((texture[0][0], texture[1][0]))
                for k, name in ((1, "epipolar_x"), (2, "epipolar_y")):
                    out[name] = Reading(
                        float(texture[0][k]) * self._camera_deg, float(texture[1][k]) * self._camera_deg
                    )
        out |= self._rolls(out)
        weights = np.array([1 / (s * s + _SURFACE_PX**2) for _, s in across])
        mean = float(weights @ [v for v, _ in across] / weights.sum())
        out["epipolar"] = Reading(mean * self._camera_deg, float(weights.sum() ** -0.5) * self._camera_deg)
        return out

    def _rolls(self, readings: dict[str, Reading]) -> dict[str, Reading]:
        """Turn of each camera about its optical axis, as far as column residual and epipolar displacement agree on it.

        A turn by a displaces the image by a times the distance from the middle: across the epipolar lines at the left
        and right edge, along them, and so in the column, at the top and bottom edge. Lens errors do one of the two.
        """
        across, along = readings.get("epipolar_x"), readings["column_y"]
        if across is None:
            return {}
        out, share = {}, baseline_shares(self.calibration)[0]
        for name, camera, part, sign in (
            ("right_roll", self.calibration.right, share, 1.0),
            ("left_roll", self.calibration.left, 1.0 - share, -1.0),
        ):
            if abs(part) < LEAST_SHARE:
                continue
            half = 0.5 * np.array(camera.size) / np.diag(camera.matrix)[:2]
            one = Reading(sign * across.value / half[self._first], across.sigma / half[self._first])
            two = Reading(
                along.value / (half[1 - self._first] * part), along.sigma / (half[1 - self._first] * abs(part))
            )
            if one.value * two.value > 0:
                out[name] = together(one, two)
        return out

    def _scanned(self, scan: ColumnScan, readings: dict[str, Reading]) -> dict[str, Reading]:
        scatter = readings.get("column_scatter")
        agrees = scatter is not None and scatter.value + SIGMAS * scatter.sigma < LIMITS["column_scatter"][0][0]
        name = "order_cost_beside_agreement" if agrees and scan.gain >= _AGREEMENT_GAIN else "order_cost"
        out = {name: Reading(scan.relative_cost, 0.0)}
        if scan.offset_px != scan.allowed_px and scan.cost < _CLEARLY_LESS * scan.allowed_cost:
            out["scanned_offset"] = Reading(scan.offset_px * self._projector_deg, 0.0)
        change = scan.allowed_px - scan.used_px
        moved = abs(change) > _LEAST_CHANGE_PX and scan.allowed_cost < _CLEARLY_LESS * scan.used_cost
        if moved and scan.gain < _MOVED_GAIN:
            out["scanned_change"] = Reading(change * self._projector_deg, 0.0)
        if scan.across_px:
            out["scanned_epipolar"] = Reading(scan.across_px * self._camera_deg, 0.0)
        return out

    def _drift(self, scan: ColumnScan) -> dict[str, Reading]:
        """Column offset of a scene whose surface gives too few patches, on which the column correction relies."""
        point = sensitivity.in_the_middle(self.calibration, self._middle_mm)
        drift = Reading(scan.allowed_px * self._projector_deg, 0.0)
        return {"scanned_drift": drift} | self._depth_offsets(Reading(scan.allowed_px, 0.0), point)

    def _depth_offsets(self, offset: Reading, points: NDArray[np.float64]) -> dict[str, Reading]:
        left, right = sensitivity.per_depth(self.calibration, points, self._first)
        return depth_offsets(offset, (float(np.median(left)), float(np.median(right))))


_SURFACE_PX = 0.02  # what slopes and textures alone make of the epipolar displacement
_PHASE_BIAS = 0.003
"""Radians by which phases of patches may be wrong alike: a fringe window on edges and curved surfaces. Where fringes
have little slope across the epipolar lines, this alone is a displacement of several pixels."""


def _independent(design: NDArray[np.float64], column: int) -> float:
    """Rms of a column of (n, k) regressors, as far as the others do not explain it."""
    others = np.delete(design, column, axis=1)
    own = design[:, column] - others @ np.linalg.lstsq(others, design[:, column], rcond=None)[0]
    return float(np.sqrt(np.mean(own * own))) + 1e-12


def together(one: Reading, two: Reading) -> Reading:
    """Weighted mean of two readings that are both certain and agree; of others the smaller one."""
    certain = all(abs(reading.value) > SIGMAS * reading.sigma for reading in (one, two))
    if not certain or abs(one.value - two.value) > _AGREEMENT * float(np.hypot(one.sigma, two.sigma)):
        return min(one, two, key=lambda reading: abs(reading.value))
    weights = one.sigma**-2, two.sigma**-2
    return Reading((weights[0] * one.value + weights[1] * two.value) / sum(weights), sum(weights) ** -0.5)
