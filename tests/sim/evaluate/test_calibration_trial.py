"""A calibration is judged by what is measured with it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.rig.calibration import Calibration
from sim.evaluate.calibration_trial import trial_scores, true_calibration
from sim.rig.disturbance import Disturbance, TrueRig
from sim.rig.optics import Optics
from sim.scene.shapes import rotation_about


def test_the_true_calibration_needs_no_motion_and_a_wrong_one_shows(small):
    optics = Optics(gamma=2.2)
    true = true_calibration(small, optics)
    found = trial_scores(true, small, optics, scenes=("plane", "spheres"))
    for result in found.values():
        assert result.score.reconstructed > 0.8
        assert result.alignment.angle_deg < 0.02
        assert result.alignment.shift_mm < 0.1
        assert result.alignment.scale == pytest.approx(1, abs=3e-4)
    disturbed = TrueRig.of(small, optics).after(Disturbance("right", turn_deg=(0.0, 0.1, 0.0))).right
    wrong = Calibration(true.left, disturbed, true.projector, true.left_color, true.right_color, true.response)
    assert (
        trial_scores(wrong, small, optics, scenes=("spheres",))["spheres"].score.rms_mm > found["spheres"].score.rms_mm
    )


def test_a_principal_point_traded_for_a_rotation_costs_no_shape(quarter):
    """The world of such a calibration is turned against the true one; what it measures is as true."""
    optics, shift_px = Optics(), 0.4
    true = true_calibration(quarter, optics)
    turn = rotation_about((0.0, 1.0, 0.0), -shift_px / true.left.matrix[0, 0])
    matrix = true.left.matrix.copy()
    matrix[0, 2] += shift_px

    def turned(device):
        return replace(device, rotation=device.rotation @ turn.T)

    other = Calibration(
        replace(true.left, matrix=matrix), turned(true.right), turned(true.projector), true.left_color, true.right_color
    )
    best, traded = (trial_scores(item, quarter, optics, scenes=("spheres",))["spheres"] for item in (true, other))
    assert traded.alignment.angle_deg == pytest.approx(np.degrees(shift_px / matrix[0, 0]), rel=0.15)
    assert traded.alignment.shift_mm > 0.5
    assert traded.score.rms_mm < 1.1 * best.score.rms_mm
    assert traded.score.reconstructed > best.score.reconstructed - 0.01
