"""What a set's column correction takes up beyond a projector's drift is a finding, and its points are withheld."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.monitor.check.set_check import SetCheck
from pipeline.multi_frame.set_reconstructor import SetReconstructor
from pipeline.rig.calibration import Calibration
from sim.evaluate.score import score
from tests.pipeline.monitor.test_consistency import PITCH, ROLL, YAW, turned
from tests.pipeline.multi_frame.sets import LAYOUT, OPTICS, SETTINGS, sequence, taken, truth

CALIBRATION = LAYOUT.calibration_for(OPTICS)
DEGREES_PER_COLUMN = float(np.degrees(1 / CALIBRATION.projector.matrix[0, 0]))


def made(mode: str, calibration: Calibration = CALIBRATION, **options) -> SetReconstructor:
    options = {"settings": SETTINGS, "check": SetCheck} | options
    return SetReconstructor(calibration, sequence(mode), LAYOUT.volume(), **options)


@pytest.mark.parametrize("mode", ["gray", "heterodyne", "two_color"])
def test_a_rig_as_calibrated_is_consistent(mode: str):
    cloud = made(mode).reconstruct(*taken(mode))
    assert cloud.consistency.verdict == "consistent", cloud.consistency
    assert cloud.points > 0.5 * cloud.gray.size


@pytest.mark.parametrize("mode", ["gray", "two_color"])
@pytest.mark.parametrize(
    ("side", "axis", "degrees", "cause"),
    [
        ("right", YAW, 0.1, "the right camera is turned about its vertical axis by 0.1"),
        ("right", YAW, -0.1, "the right camera is turned about its vertical axis by 0.1"),
        ("right", ROLL, 0.5, "the projector is turned about its optical axis"),
    ],
)
def test_nothing_is_published_when_a_device_has_turned(mode: str, side: str, axis: tuple, degrees: float, cause: str):
    calibration = turned(CALIBRATION, side, axis, degrees)
    unchecked = made(mode, calibration, check=None).reconstruct(*taken(mode))
    assert unchecked.points > 0.4 * unchecked.gray.size and unchecked.consistency is None
    if axis == YAW:
        assert score(unchecked.xyz, truth()).wrong > 0.9
    cloud = made(mode, calibration).reconstruct(*taken(mode))
    assert cloud.consistency.verdict == "inconsistent", cloud.consistency
    assert cloud.points == 0
    assert cause in cloud.consistency.cause
    warned = made(mode, calibration, withhold=False).reconstruct(*taken(mode))
    np.testing.assert_array_equal(warned.xyz, unchecked.xyz)
    assert warned.consistency == cloud.consistency


def test_the_correction_of_a_refuted_set_is_not_kept():
    other = made("gray", turned(CALIBRATION, "right", YAW, 0.1))
    fresh = other.state()
    other.reconstruct(*taken("gray"))
    assert other.state()[0][1] is fresh[0][1] is False
    np.testing.assert_array_equal(other.correction, fresh[0][0])


def test_a_correction_that_was_not_measured_is_unknown():
    unmeasured = made("gray", settings=replace(SETTINGS, self_calibrate=False)).reconstruct(*taken("gray"))
    assert unmeasured.consistency.verdict == "unknown"
    dark = [np.full_like(image, 4) for image in taken("gray")[0]]
    cloud = made("gray").reconstruct(dark, dark)
    assert (cloud.points, cloud.consistency.verdict) == (0, "unknown")


@pytest.mark.parametrize(
    ("correction", "verdict"),
    [
        ((0.0, 0.0, 0.0), "consistent"),
        ((0.01 / DEGREES_PER_COLUMN, 0.0, 0.0), "consistent"),
        ((0.015 / DEGREES_PER_COLUMN, 0.0, 0.0), "doubtful"),
        ((-0.04 / DEGREES_PER_COLUMN, 0.0, 0.0), "inconsistent"),
        ((0.0, 0.0, 2e-4), "consistent"),
        ((-0.2559, 0.0, 2e-3), "inconsistent"),
    ],
)
def test_a_correction_is_judged_in_the_middle_and_by_its_slopes(correction: tuple, verdict: str):
    assert SetCheck(CALIBRATION, LAYOUT.volume(), 0)(np.array(correction), True).verdict == verdict


def test_a_pitch_does_not_show():
    cloud = made("gray", turned(CALIBRATION, "right", PITCH, 0.1)).reconstruct(*taken("gray"))
    assert cloud.consistency.verdict == "consistent"
    assert score(cloud.xyz, truth()).wrong < 0.012
