"""A projector that moved since the calibration is corrected by one single-shot pair of a scene at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.calibrate.projector.trinocular_residual import moved, refine_projector, spread
from pipeline.calibrate.projector.trinocular_samples import PairSampler
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.renders import render_pair

DISTURBANCE = {"cx": 0.25, "rotation_y": np.deg2rad(0.01), "focal": 1e-4}


@pytest.mark.slow
def test_one_pair_corrects_a_disturbed_projector() -> None:
    layout, optics = RigLayout().scaled(0.5), Optics()
    true, pattern = layout.calibration_for(optics), layout.pattern()
    disturbed = replace(true, projector=moved(true.projector, DISTURBANCE))
    pair = render_pair(layout, build("spheres"), pattern, optics, seed=3)
    samples = PairSampler(disturbed, pattern, layout.volume(), stride=3)(pair.left, pair.right)
    assert len(samples) > 5000
    assert spread(true.projector, samples).systematic_px < 0.02
    got = refine_projector(disturbed, samples)
    assert got.before.systematic_px > 0.2
    assert got.after.systematic_px < 0.02
    surface = pair.truth_left.xyz[pair.truth_left.scorable][::40].astype(np.float64)
    columns = (got.calibration.projector.project(surface) - true.projector.project(surface))[:, 0]
    assert np.sqrt((columns**2).mean()) < 0.02
