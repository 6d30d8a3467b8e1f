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
from pipeline.monitor.observe import Observer, Patches
from pipeline.monitor.robust import fit, scale_of
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.consistency import ColumnScan, Consistency, Reading
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

LIMITS: dict[str, tuple[tuple[float, float], str]] = {
    "column_offset": ((0.012, 0.030), "degrees of the projector"),
    "depth_offset": ((2.0, 4.0), "mm of depth, if it was the right camera"),
    "column_x": ((0.006, 0.010), "degrees of the projector, middle to edge"),
    "column_y": ((0.0025, 0.0050), "degrees of the projector, middle to edge"),
    "column_scatter": ((0.025, 0.032), "rad of the fringe's phase"),
    "epipolar": ((0.014, 0.025), "degrees of the right camera"),
    "epipolar_x": ((0.030, 0.050), "degrees of the right camera, middle to edge"),
    "epipolar_y": ((0.020, 0.040), "degrees of the right camera, middle to edge"),
    "left_roll": ((0.020, 0.033), "degrees"),
    "right_roll": ((0.020, 0.033), "degrees"),
    "order_cost": ((0.50, 0.60), "of the cost of unrelated phases"),
    "order_cost_beside_agreement": ((0.50, np.inf), "of the cost of unrelated phases"),
    "scanned_drift": ((0.012, 0.030), "degrees of the projector"),
    "scanned_offset": ((np.inf, 0.0), "degrees of the projector"),
    "scanned_change": ((np.inf, 0.0), "degrees of the projector"),
    "scanned_epipolar": ((np.inf, 0.0), "degrees of the right camera"),
}
"""Limit of ``doubtful``, limit of ``inconsistent``, unit."""
SIGMAS = 4.0
"""A reading is beyond a limit when it is so by this many of its standard deviations."""
_AGREEMENT = 3.0  # standard deviations of the difference
_LEAST_PATCHES = 16
_CLEARLY_LESS = 0.85
_AGREEMENT_GAIN = 0.005
"""Gain of :class:`pipeline.reconstruct.consistency.ColumnScan` from which some pixels agree up to noise. Where patches
agree as well, a high cost of all pixels is that of surfaces out of reach or of an unknown response, no refutation."""
_LEAST_CHANGE_PX = 0.3
"""Columns from the correction in use to the offset that costs clearly less, in steps of a quarter of a column."""
_LEAST_SHARE = 0.05


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
        return judged(readings, self._cause(readings))

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
        per_mm = float(np.median(sensitivity.along_ray(self.calibration, patches.shape[:, :3], self._first)[0]))
        out["depth_offset"] = Reading(-float(value[0]) / per_mm, float(sigma[0]) / abs(per_mm))
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
        out, share = {}, self._baseline_share()
        for name, camera, part, sign in (
            ("right_roll", self.calibration.right, share, 1.0),
            ("left_roll", self.calibration.left, 1.0 - share, -1.0),
        ):
            if abs(part) < _LEAST_SHARE:
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
        if moved and scan.gain < _AGREEMENT_GAIN:
            out["scanned_change"] = Reading(change * self._projector_deg, 0.0)
        if scan.across_px:
            out["scanned_epipolar"] = Reading(scan.across_px * self._camera_deg, 0.0)
        return out

    def _drift(self, scan: ColumnScan) -> dict[str, Reading]:
        """Column offset of a scene whose surface gives too few patches, on which the column correction relies."""
        middle = self.calibration.left.normalise((np.array([self.calibration.left.size]) - 1.0) / 2)
        point = np.append(middle[0], 1.0)[None] * self._middle_mm
        per_mm = float(sensitivity.along_ray(self.calibration, point, self._first)[0][0])
        return {
            "scanned_drift": Reading(scan.allowed_px * self._projector_deg, 0.0),
            "depth_offset": Reading(-scan.allowed_px / per_mm, 0.0),
        }

    def _cause(self, readings: dict[str, Reading]) -> str:
        """Device, axis and angle that explain the largest reading; two devices where they cannot be separated."""
        beyond = {name: abs(reading.value) for name, reading in readings.items() if _excess(name, reading) > 0}
        scanned = [name for name in ("scanned_offset", "scanned_change") if name in beyond]
        if scanned or beyond.keys() & {"column_offset", "scanned_drift", "depth_offset"}:
            measured = "column_offset" if "column_offset" in readings else "scanned_drift"
            offset = abs(readings[(*scanned, measured)[0]].value)
            return (
                f"the right camera is turned about its vertical axis by {offset / self._baseline_share():.2f} degrees, "
                f"or the projector by {offset:.2f} degrees: one pair does not separate them"
            )
        for name in ("scanned_epipolar", "epipolar"):
            if name in beyond:
                return f"a camera is turned about its horizontal axis by {beyond[name]:.2f} degrees"
        for side in ("right", "left"):
            if f"{side}_roll" in beyond:
                angle = beyond[f"{side}_roll"]
                return f"the {side} camera is turned about its optical axis by {angle:.2f} degrees"
        left = self.calibration.left
        if "epipolar_x" in beyond or "epipolar_y" in beyond:
            return "a camera is turned about its optical axis, or its lens differs from the calibrated one"
        if "column_y" in beyond:
            angle = beyond["column_y"] / (0.5 * left.size[1] / left.matrix[1, 1])
            return f"the projector is turned about its optical axis by {angle:.2f} degrees"
        if "column_x" in beyond:
            return "a focal length differs from the calibrated one, or a device has moved along the baseline"
        if "order_cost" in beyond:
            return "the images do not belong to this calibration: cameras exchanged, or a device has moved far"
        return "a device has moved" if beyond else ""

    def _baseline_share(self) -> float:
        """Distance left camera to projector over the distance of the cameras."""
        left, right = self.calibration.left.centre, self.calibration.right.centre
        share = (self.calibration.projector.centre - left) @ (right - left) / ((right - left) @ (right - left))
        return max(abs(float(share)), _LEAST_SHARE)


_SURFACE_PX = 0.02  # what slopes and textures alone make of the epipolar displacement
_PHASE_BIAS = 0.003
"""Radians by which phases of patches may be wrong alike: a fringe window on edges and curved surfaces. Where fringes
have little slope across the epipolar lines, this alone is a displacement of several pixels."""


def _independent(design: NDArray[np.float64], column: int) -> float:
    """Rms of a column of (n, k) regressors, as far as the others do not explain it."""
    others = np.delete(design, column, axis=1)
    own = design[:, column] - others @ np.linalg.lstsq(others, design[:, column], rcond=None)[0]
    return float(np.sqrt(np.mean(own * own))) + 1e-12


def judged(readings: dict[str, Reading], cause: str = "") -> Consistency:
    """The verdict of readings: the worst of all; unknown where the surface gives none."""
    findings, worst = [], 0
    for name, reading in readings.items():
        level = 2 if _excess(name, reading) > 0 else 1 if _excess(name, reading, which=0) > 0 else 0
        if level:
            limits, unit = LIMITS[name]
            findings.append(f"{name} {reading.value:+.4f} +- {reading.sigma:.4f}, limit {limits[level - 1]:g} {unit}")
        worst = max(worst, level)
    if "column_offset" not in readings and worst < 2:
        return Consistency("unknown", readings, tuple(findings))
    verdict = ("consistent", "doubtful", "inconsistent")[worst]
    return Consistency(verdict, readings, tuple(findings), cause if worst == 2 else "")  # type: ignore[arg-type]


def together(one: Reading, two: Reading) -> Reading:
    """Weighted mean of two readings that are both certain and agree; of others the smaller one."""
    certain = all(abs(reading.value) > SIGMAS * reading.sigma for reading in (one, two))
    if not certain or abs(one.value - two.value) > _AGREEMENT * float(np.hypot(one.sigma, two.sigma)):
        return min(one, two, key=lambda reading: abs(reading.value))
    weights = one.sigma**-2, two.sigma**-2
    return Reading((weights[0] * one.value + weights[1] * two.value) / sum(weights), sum(weights) ** -0.5)


def _excess(name: str, reading: Reading, which: int = 1) -> float:
    """How far a reading is beyond a limit for certain.

    The deviation of a scatter is proportional to the scatter itself. What a rig at the limit would show is decisive, so
    the deviation is that of the limit; of what was read it would grow with it, and hide a scatter of twice the limit.
    """
    value, limit = abs(reading.value), LIMITS[name][0][which]
    sigma = reading.sigma * min(1.0, limit / value) if name == "column_scatter" and value else reading.sigma
    return value - SIGMAS * sigma - limit
