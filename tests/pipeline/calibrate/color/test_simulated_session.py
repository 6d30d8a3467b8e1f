"""A colour session on the simulated rig's plane, checked on another pattern."""

import functools

import numpy as np
import pytest

from pipeline.calibrate.color import calibrate_color, check_sequence, color_sequence, phase_error
from sim.render.projection_transport import Stage
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

LAYOUT = RigLayout().scaled(0.1875)
OPTICS = Optics(gamma=2.2, crosstalk=0.12, precorrected=False)


def capture(sequence, seed, response=None):
    return [stage().images(stage().counts(frame.image(response)), seed + i) for i, frame in enumerate(sequence.frames)]


@functools.cache
def stage():
    return Stage(LAYOUT, build("plane"), OPTICS)


@pytest.mark.slow
def test_a_session_takes_crosstalk_and_gamma_out_of_the_phase():
    sequence = color_sequence(LAYOUT.projector_size, lateral_chromatic=False)
    found = calibrate_color(capture(sequence, 0), sequence)
    for model, true in zip((found.left, found.right), OPTICS.true_crosstalk(), strict=True):
        assert np.abs(model.crosstalk - true).max() < 0.01
        assert np.abs(np.linalg.inv(model.crosstalk) @ true - np.eye(3)).max() < 0.01
    assert np.abs(found.response.curves - OPTICS.response_table()[1]).max() < 0.005

    check = check_sequence(LAYOUT.pattern())
    before, after = capture(check, 500), capture(check, 600, found.response)
    for side, model in enumerate((found.left, found.right)):
        was = phase_error([pair[side] for pair in before], check)
        now = phase_error([pair[side] for pair in after], check, color=model)
        assert was.systematic_rad > 0.1
        assert now.systematic_rad < was.systematic_rad / 8
