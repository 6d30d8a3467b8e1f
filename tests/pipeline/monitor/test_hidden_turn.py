"""The turn of the right camera that shifts every order by one: its angle, what it leaves, and a measurement of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.calibration.disturbed import answer, images_of
from benchmarks.reconstruction.cases import Case
from pipeline.monitor.hidden_turn import HiddenTurn, hidden_turn
from pipeline.rig.volume import Volume
from sim.rig.disturbance import Disturbance
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from tests.pipeline.small import mirrored

NARROW = RigLayout(
    focal_px=4136.0, baseline_mm=337.0, projector_fraction=0.82, standoff_mm=1771.0, projector_focal_px=4900.0
)


def turn_of(layout: RigLayout) -> HiddenTurn:
    found = hidden_turn(layout.calibration(), layout.pattern(), layout.volume())
    assert found is not None
    return found


def test_the_angle_is_a_period_over_the_share_of_the_baseline():
    layout = RigLayout()
    period_deg = np.degrees(layout.projector_size[0] / layout.periods / layout.projector_focal_px)
    found = turn_of(layout)
    assert found.degrees == pytest.approx(period_deg / layout.projector_fraction, rel=0.05)
    expected = layout.standoff_mm**2 / layout.baseline_mm * np.radians(found.degrees)
    assert found.depth_mm == pytest.approx(expected, rel=0.1)


def test_more_fringes_make_the_angle_smaller_in_proportion():
    ratio = turn_of(RigLayout(periods=48.0)).degrees / turn_of(RigLayout(periods=96.0)).degrees
    assert ratio == pytest.approx(2.0, rel=0.05)


def test_a_wide_field_shows_the_turn_and_a_narrow_one_hides_it():
    assert not turn_of(RigLayout()).hidden
    assert turn_of(NARROW).hidden
    assert turn_of(NARROW).slope_deg < 0.2 * turn_of(RigLayout()).slope_deg


def test_fringes_along_the_other_axis_give_the_same():
    layout = RigLayout()
    pattern = layout.pattern()
    upright = replace(pattern, size=pattern.size[::-1], axis="y")
    found = hidden_turn(mirrored(layout.calibration()), upright, layout.volume())
    assert found is not None
    assert tuple(found) == pytest.approx(tuple(turn_of(layout)), rel=0.02)


def test_a_volume_that_the_devices_do_not_see_gives_none():
    layout = RigLayout()
    assert hidden_turn(layout.calibration(), layout.pattern(), Volume(near_mm=20.0, far_mm=40.0)) is None


def test_a_projector_at_the_left_camera_shows_no_turn_at_all():
    layout = RigLayout(projector_fraction=0.0)
    assert hidden_turn(layout.calibration(), layout.pattern(), layout.volume()) is None


@pytest.mark.long
@pytest.mark.timeout(120)
def test_such_a_turn_is_as_large_as_computed_and_modulated_fringes_show_it():
    """All points are off by the depth that was computed, and the check finds the pair of plain fringes consistent."""
    layout = NARROW.scaled(0.5)
    turn = turn_of(layout)
    plain = Case("narrow", "mixed", Optics(), layout, periods=layout.periods)
    images = images_of(plain, Disturbance("right", turn_deg=(0.0, -turn.degrees, 0.0)))
    found = answer(plain, images)
    assert found.errors.wrong > 0.95
    assert found.found.verdict == "consistent"
    modulated = replace(plain, modulated=True)
    shown = answer(modulated, images_of(modulated, Disturbance("right", turn_deg=(0.0, -turn.degrees, 0.0))))
    assert shown.points < 0.2 * found.points
