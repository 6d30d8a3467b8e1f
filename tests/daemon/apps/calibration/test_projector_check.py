"""The check by all pixels keeps a correct projector, and refines and reports a wrong one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from daemon.apps.calibration.solve.projector_check import WORTH_PX, check_projector
from daemon.apps.calibration.views.detect_marks import Phases
from pipeline.calibrate.projector.absolute_phase import Coordinate
from pipeline.calibrate.projector.trinocular_residual import moved
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from sim.rig.layout import RigLayout

NOISE_PX = 0.02


def camera_phases(rig: Calibration, camera: CameraModel, slope: tuple[float, float], seed: int) -> Phases:
    """Projector coordinates of each pixel of a camera, for the plane ``z = 1400 + slope . (x, y)``."""
    rays = np.concatenate([camera.rays(), np.ones((*camera.size[::-1], 1))], axis=-1) @ camera.rotation
    normal = np.array([-slope[0], -slope[1], 1.0])
    points = camera.centre + rays * ((1400.0 - normal @ camera.centre) / (rays @ normal))[..., None]
    pixels = rig.projector.project(points) + np.random.default_rng(seed).normal(0, NOISE_PX, (*rays.shape[:2], 2))
    pixels[((pixels < 0) | (pixels > np.array(rig.projector.size) - 1)).any(axis=-1)] = np.nan
    even, clear = np.full(rays.shape[:2], 100.0), np.zeros(rays.shape[:2], bool)
    x, y = (Coordinate(pixels[..., k], np.full(even.shape, NOISE_PX), even, even, clear) for k in range(2))
    return x, y


@pytest.fixture(scope="module")
def rig() -> Calibration:
    return RigLayout().scaled(0.5).calibration()


@pytest.fixture(scope="module")
def phases(rig: Calibration) -> list[tuple[Phases, Phases]]:
    slopes = ((0.0, 0.0), (0.4, 0.1), (-0.3, 0.3))
    return [
        (camera_phases(rig, rig.left, s, 2 * k), camera_phases(rig, rig.right, s, 2 * k + 1))
        for k, s in enumerate(slopes)
    ]


def test_a_correct_projector_is_unchanged(rig: Calibration, phases: list[tuple[Phases, Phases]]) -> None:
    found = check_projector(rig, phases)
    assert found is not None and not found.refined and found.calibration is rig
    assert found.residual_px < 0.25 * WORTH_PX and "agree" in found.note


def test_a_wrong_projector_is_refined(rig: Calibration, phases: list[tuple[Phases, Phases]]) -> None:
    wrong = replace(rig, projector=moved(rig.projector, {"cx": 0.3, "rotation_x": 2e-4, "focal": 2e-4}))
    found = check_projector(wrong, phases)
    assert found is not None and found.refined and found.before_px > 0.1
    assert found.residual_px < 0.25 * WORTH_PX and "refined" in found.note
    assert found.calibration.left is wrong.left and found.calibration.right is wrong.right


def test_views_without_usable_pixels_change_nothing(rig: Calibration) -> None:
    nothing = np.full(rig.left.size[::-1], np.nan)
    dark = Coordinate(nothing, nothing, np.zeros_like(nothing), np.zeros_like(nothing), np.zeros(nothing.shape, bool))
    assert check_projector(rig, [((dark, dark), (dark, dark))]) is None
