"""Devices that do not match each other or the files give a warning with both numbers and the remedy."""

from __future__ import annotations

import pytest

from daemon.live.acquisition.camera_status import CameraState, CameraStatus
from daemon.live.compatibility import projector_problem, size_problem, timing_warnings
from drivers.protocols import ProjectorInfo
from sim.rig.layout import RigLayout


def camera(exposure_us: float) -> CameraStatus:
    return CameraStatus(CameraState.ACQUIRING, exposure_us=exposure_us)


@pytest.mark.parametrize("periods", [1, 2, 3])
@pytest.mark.parametrize("refresh_hz", [50.0, 59.94, 60.0, 120.0])
def test_whole_periods_are_good_and_others_give_a_warning_with_the_nearest_whole_one(
    refresh_hz: float, periods: int
) -> None:
    whole_us = periods * 1e6 / refresh_hz
    assert timing_warnings(refresh_hz, {"left": camera(whole_us), "right": camera(whole_us * 1.002)}) == []
    (warning,) = timing_warnings(refresh_hz, {"left": camera(whole_us), "right": camera(whole_us + 0.2e6 / refresh_hz)})
    assert (
        "camera right" in warning
        and f"{whole_us:.0f} us are {periods}" in warning
        and f"{refresh_hz:.3f} Hz" in warning
    )


def test_60_hz_exposures_at_59_94_hz_are_whole_enough_but_a_shorter_one_than_a_period_is_not() -> None:
    assert timing_warnings(59.94, {"left": camera(16667.0)}) == []
    assert "are 1" in timing_warnings(59.94, {"left": camera(2000.0)})[0]


def test_unknown_quantities_give_no_warning() -> None:
    assert timing_warnings(0.0, {"left": camera(123.0)}) == []
    assert timing_warnings(60.0, {"left": camera(0.0)}) == []


def test_sizes_must_be_those_of_the_files() -> None:
    layout = RigLayout()
    calibration, pattern = layout.calibration(), layout.pattern()
    assert size_problem("left", (1024, 820), calibration) == ""
    assert size_problem("left", (0, 0), calibration) == ""
    assert "camera right sends 640 x 480" in size_problem("right", (640, 480), calibration)
    assert projector_problem(ProjectorInfo("HDMI-1", (1280, 1024), 60.0), pattern) == ""
    assert "HDMI-1 shows 1920 x 1080" in projector_problem(ProjectorInfo("HDMI-1", (1920, 1080), 60.0), pattern)
