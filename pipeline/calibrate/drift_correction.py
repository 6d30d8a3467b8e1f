"""Correction of small drifts from ordinary scenes: the rotation of one device.

Half of the pairs determine the correction, the other half evaluate it. One device is rotated: the only one that
explains the readings (see :mod:`pipeline.monitor.explain`), or the one that is named. A projector is refined in full by
:mod:`pipeline.calibrate.projector.trinocular_residual`. The cameras' distances and lenses stay: a scene without known
lengths does not determine them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.projector.trinocular_residual import Samples, refine_projector
from pipeline.common.errors import CalibrationError
from pipeline.monitor.explain import DEVICES, GEOMETRY, Rotation, explain, rotated, unambiguous
from pipeline.monitor.observe import Observer, Patches, Reading
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.volume import Volume

Pixels = NDArray[np.uint8]
Pair = tuple[Pixels, Pixels]

MOST_PAIRS = 24
LARGEST_DEG = 0.5
_FEWEST_PAIRS = 2
_FEWEST_PATCHES = 60
_ROUNDS = 3
_PATCHES = 600
_WORTH = 3.0  # standard deviations that a residual must have before anything is corrected
_SMALL_PX = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Refinement:
    """A proposed correction.

    Args:
        calibration: the corrected one; device: that was corrected.
        turn_deg, sigma_deg: of the device, about its own axes.
        before, after: readings of the held-out pairs.
        points: median number of points of a pair, before and after.
        explanations: every device, for the readings before.
        pairs: numbers used for the correction, and held out.
    """

    calibration: Calibration
    device: str
    turn_deg: tuple[float, float, float]
    sigma_deg: tuple[float, float, float]
    before: dict[str, Reading]
    after: dict[str, Reading]
    points: tuple[int, int]
    explanations: list[Rotation]
    pairs: tuple[int, int]

    @property
    def better(self) -> bool:
        """Whether the held-out pairs agree better."""
        return _size(self.after) < _size(self.before)


class _Evaluation:
    """Readings of pairs under one calibration."""

    def __init__(self, calibration: Calibration, pattern: ColorFringe, volume: Volume, encoding: str) -> None:
        self.calibration = calibration
        self._reconstructor = Reconstructor(calibration, pattern, volume, encoding=encoding)
        self._observer = Observer(calibration, pattern, volume, encoding=encoding, patches=_PATCHES)
        self.first = self._observer.first

    def at(self, pairs: Iterable[Pair]) -> tuple[dict[str, Reading], Patches, int]:
        """Readings of all patches of the pairs together, the patches, and the median number of points."""
        found, points = [], []
        for left, right in pairs:
            cloud = self._reconstructor.reconstruct(left, right)
            points.append(cloud.points)
            found.append(self._observer.patches(left, right, cloud))
        patches = Patches(*(np.concatenate([getattr(one, name) for one in found]) for name in Patches.__slots__))
        if len(patches) < _FEWEST_PATCHES:
            raise CalibrationError(
                f"only {len(patches)} smooth patches are measured, at least {_FEWEST_PATCHES} are needed; show "
                "a scene that fills the images, or calibrate again if hardly anything can be measured"
            )
        return self._observer.readings(patches), patches, int(np.median(points))

    def samples(self, patches: Patches) -> Samples:
        """Patches as samples for the projector."""
        observed = patches.shape[:, 11] + self._observer.residuals(patches)
        n = len(patches)
        return Samples(patches.shape[:, :3], observed, np.full(n, self.first), np.full(n, 0.02))


def refine(
    calibration: Calibration,
    pattern: ColorFringe,
    volume: Volume,
    encoding: str,
    pairs: Sequence[Pair],
    *,
    device: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Refinement:
    """The correction of one device with which ordinary pairs agree.

    Args:
        pairs: raw images of one scene or, better, of several; at most :data:`MOST_PAIRS` are used.
        device: ``left``, ``right`` or ``projector``; None = the only one that explains the readings.

    Raises:
        CalibrationError: too few pairs or surfaces, nothing to correct, more than one device that explains it, or a
            drift that is too large.
    """
    if len(pairs) < _FEWEST_PAIRS:
        raise CalibrationError(f"{len(pairs)} pairs of images, at least {_FEWEST_PAIRS} are needed")
    chosen = [pairs[i] for i in np.unique(np.linspace(0, len(pairs) - 1, min(len(pairs), MOST_PAIRS)).astype(int))]
    train, held_out = chosen[::2], chosen[1::2]
    steps = _ROUNDS + 3

    def report_progress(done: int) -> None:
        if progress is not None:
            progress(done, steps)

    report_progress(0)
    before, _, points = _Evaluation(calibration, pattern, volume, encoding).at(held_out)
    report_progress(1)
    now, sum_deg = calibration, np.zeros(3)
    explanations: list[Rotation] = []
    rotation: Rotation | None = None
    for number in range(_ROUNDS):
        evaluation = _Evaluation(now, pattern, volume, encoding)
        readings, patches, _ = evaluation.at(train)
        found = explain(now, patches.shape, evaluation.first, readings)
        if not explanations:
            explanations = found
            _require_drift(readings)
            device = device or _only_explanation(found)
        rotation = next(one for one in found if one.device == device)
        now = (
            _projector(now, rotation, evaluation.samples(patches))
            if device == "projector"
            else rotated(now, rotation.device, rotation.angle_deg)
        )
        sum_deg += rotation.angle_deg
        _require_small(sum_deg, rotation.device)
        report_progress(number + 2)
    assert rotation is not None  # noqa: S101 - there was at least one round
    after, _, points_after = _Evaluation(now, pattern, volume, encoding).at(held_out)
    report_progress(steps)
    total = float(sum_deg[0]), float(sum_deg[1]), float(sum_deg[2])
    return Refinement(
        now, rotation.device, total, rotation.sigma_deg, before, after, (points, points_after), explanations,
        (len(train), len(held_out)),
    )  # fmt: skip


def _projector(now: Calibration, rotation: Rotation, samples: Samples) -> Calibration:
    """The projector refined in full, or only rotated where the surfaces fill too little of its image."""
    try:
        return refine_projector(now, samples).calibration
    except CalibrationError:
        return rotated(now, rotation.device, rotation.angle_deg)


def _require_drift(readings: dict[str, Reading]) -> None:
    known = [readings[name] for name in GEOMETRY if name in readings]
    if all(abs(one.value) < max(_WORTH * one.sigma, _SMALL_PX) for one in known):
        worst = max((abs(one.value) for one in known), default=0.0)
        raise CalibrationError(
            f"there is nothing to correct: the largest residual is {worst:.3f} px, within the noise; "
            "the calibration fits these images"
        )


def _require_small(turn_deg: NDArray[np.float64], device: str) -> None:
    size = float(np.linalg.norm(turn_deg))
    if size > LARGEST_DEG:
        raise CalibrationError(
            f"the {device} would have to be rotated by {size:.2f} degrees, limit {LARGEST_DEG} degrees: that is no "
            "small drift; calibrate again"
        )


def _only_explanation(explanations: list[Rotation]) -> str:
    best = unambiguous(explanations)
    if best is not None:
        return best.device
    texts = ", ".join(
        f"{one.device} {np.linalg.norm(one.angle_deg):.3f} degrees (misfit {one.misfit:.1f})" for one in explanations
    )
    raise CalibrationError(
        f"more than one device explains the residuals, or none does: {texts}. Name the one that was touched "
        f"with --device {'|'.join(DEVICES)}, or calibrate again"
    )


def _size(readings: dict[str, Reading]) -> float:
    return float(sum(readings[name].value ** 2 for name in GEOMETRY if name in readings))


def table(found: Refinement) -> list[str]:
    """The report, line by line."""
    names = {
        "column_px": "trinocular residual, px",
        "column_x_px": "  its change to the left and right edge",
        "column_y_px": "  its change to the top and bottom edge",
        "epipolar_px": "epipolar residual, px",
    }
    rotation = "  ".join(
        f"{axis} {value:+.4f} +- {sigma:.4f}"
        for axis, value, sigma in zip("xyz", found.turn_deg, found.sigma_deg, strict=True)
    )
    out = [f"{found.device} turned about its own axes, degrees: {rotation}"]
    out.append(f"evaluated on {found.pairs[1]} held-out pairs (corrected on {found.pairs[0]}):")
    out.append(f"{'':40} {'before':>18} {'after':>18}")
    for name, text in names.items():
        cells = [
            f"{one[name].value:+.4f} +- {one[name].sigma:.4f}" if name in one else "not observable"
            for one in (found.before, found.after)
        ]
        out.append(f"{text:40} {cells[0]:>18} {cells[1]:>18}")
    out.append(f"{'points of a pair':40} {found.points[0]:>18} {found.points[1]:>18}")
    return out
