"""The figure of merit of a layout: zero at integer ratios, best at the golden one, for any lenses."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError
from pipeline.pattern.color_fringe import modulated_profile
from pipeline.pattern.order_check import merit_of, order_check, order_warning
from pipeline.rig.volume import Volume
from sim.rig.layout import RigLayout


def assessed(fraction: float, **layout):
    rig = RigLayout(projector_fraction=fraction, **layout)
    return order_check(rig.calibration(), rig.volume())


@pytest.mark.parametrize("fraction", [0.2, 0.25, 1 / 3, 0.382, 0.45, 0.5, 0.618, 0.75])
@pytest.mark.parametrize("up", [0.0, 60.0, -200.0])
def test_the_ratio_is_that_of_the_baselines_along_the_fringes(fraction, up):
    """A projector above the baseline changes nothing: its columns do not change."""
    found = assessed(fraction, projector_up_mm=up)
    assert found.ratio == pytest.approx(1 / fraction, rel=2e-3)
    assert found.ratio_right == pytest.approx(1 / (1 - fraction), rel=2e-3)
    assert found.fraction == pytest.approx(fraction, rel=2e-3)


@pytest.mark.parametrize(("fraction", "ratio"), [(0.5, 2), (0.25, 4), (0.75, 4 / 3)])
def test_middle_and_quarter_have_no_merit(fraction, ratio):
    found = assessed(fraction)
    assert found.ratio == pytest.approx(ratio, rel=1e-3)
    assert found.merit < 0.02 and not found.good and found.residual_rad < 0.02
    assert "not noticed" in found.recommendation and "frequency-modulated" in found.recommendation


def test_the_golden_ratio_is_best():
    merits = {
        fraction: assessed(fraction).merit for fraction in (0.2, 0.25, 0.3, 1 / 3, 0.4, 0.45, 0.5, 0.55, 0.65, 0.7)
    }
    assert assessed(0.382).merit > 0.98 and assessed(0.618).merit > 0.98
    assert max(merits.values()) < 0.98
    for shifts in (12, 20, 40, 100):
        golden = merit_of(1 / 0.381966, 1 / 0.618034, shifts)[0]
        assert golden == pytest.approx(1, abs=1e-3)
        assert golden >= max(merit_of(1 / f, 1 / (1 - f), shifts)[0] for f in np.linspace(0.05, 0.95, 500)) - 1e-3


def test_left_and_right_can_be_exchanged():
    for fraction in (0.3, 0.36, 0.45):
        assert assessed(fraction).merit == pytest.approx(assessed(1 - fraction).merit, abs=0.02)


def test_the_recommendation_names_the_position_of_the_projector():
    assert "59 mm towards the left camera, to 0.382" in assessed(0.499999).recommendation
    assert "66 mm towards the right camera, to 0.382" in assessed(0.25).recommendation
    assert "distinguished well" in assessed(0.382).recommendation


@pytest.mark.parametrize(
    ("fraction", "expected"), [(0.382, ""), (0.45, ""), (0.5, "towards the"), (0.0, "do not determine")]
)
def test_a_layout_that_cannot_distinguish_orders_is_reported(fraction, expected):
    rig = RigLayout(projector_fraction=fraction)
    equal = rig.pattern()
    warning = order_warning(rig.calibration(), rig.volume(), equal)
    assert expected in warning and bool(warning) == bool(expected)
    modulated = replace(equal, profile=modulated_profile(equal.length, equal.periods))
    assert order_warning(rig.calibration(), rig.volume(), modulated) == ""


def test_the_number_of_candidates_is_that_of_the_volume():
    rig = RigLayout(projector_fraction=0.382)
    shallow = order_check(rig.calibration(), Volume(1395, 1405))
    deep = order_check(rig.calibration(), Volume(1100, 1700))
    assert shallow.orders == 1 and deep.orders > 2 * assessed(0.382).orders
    assert order_check(rig.calibration(), Volume(1100, 1700), periods=32).orders < deep.orders / 2


def test_a_projector_at_a_cameras_position_is_an_error():
    rig = RigLayout(projector_fraction=0.0)
    with pytest.raises(CalibrationError, match="do not determine the depth"):
        order_check(rig.calibration(), rig.volume())


def test_a_camera_turned_away_is_an_error():
    rig = RigLayout().calibration()
    back = np.diag([-1.0, 1.0, -1.0])
    right = replace(rig.right, rotation=back @ rig.right.rotation, translation=back @ rig.right.translation)
    with pytest.raises(CalibrationError, match="not in front of all devices"):
        order_check(replace(rig, right=right), Volume(1200, 1600))
