"""The width of the fringes in the image, and the warning where a mosaic does not resolve it."""

from __future__ import annotations

import re

import pytest

from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.fringe_width import NARROWEST_PX, fringe_period_px, width_warnings
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig.layout import RigLayout
from tests.pipeline import rigs

LAYOUT = RigLayout().scaled(0.125)


def pattern_of(width_px: float) -> ColorFringe:
    """Fringes of this width in the left image."""
    rig = LAYOUT.calibration()
    one = fringe_period_px(rig, ColorFringe(size=rig.projector.size, periods=1.0))
    return ColorFringe(size=rig.projector.size, periods=one / width_px)


def test_the_period_is_that_of_the_rig() -> None:
    rig = rigs.rig()
    pattern = ColorFringe(size=rig.projector.size, periods=rig.projector.size[0] / 10)
    ratio = rig.left.matrix[0, 0] / rig.projector.matrix[0, 0]
    assert fringe_period_px(rig, pattern) == pytest.approx(10 * ratio)


@pytest.mark.parametrize("width_px", [4.0, 6.7, 8.4, 8.6, 20.0])
def test_narrow_fringes_are_a_warning_for_a_mosaic_alone(width_px: float) -> None:
    pattern, rig = pattern_of(width_px), LAYOUT.calibration()
    assert width_warnings(rig, pattern, mosaic=False) == ()
    found = width_warnings(rig, pattern, mosaic=True)
    assert len(found) == (width_px < NARROWEST_PX)
    if found:
        assert f"{width_px:.1f} pixels wide" in found[0]
        most = re.search(r"at most (\d+) periods", found[0])
        assert most is not None
        wider = ColorFringe(size=pattern.size, periods=float(most[1]))
        assert width_warnings(rig, wider, mosaic=True) == ()


@pytest.mark.parametrize(("encoding", "expected"), [("rgb8", 0), ("bayer_rggb8", 1)])
def test_a_reconstructor_warns_of_narrow_fringes(encoding: str, expected: int) -> None:
    made = Reconstructor(LAYOUT.calibration(), pattern_of(6.0), LAYOUT.volume(), encoding=encoding)
    assert sum("too narrow" in warning for warning in made.warnings) == expected
