"""A projector that moved since calibration is brought back by one single-shot pair of a scene at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pipeline.reconstruct import Reconstructor
from pipeline.settings import Settings
from pipeline.trinocular import moved, refine_projector, spread
from pipeline.trinocular_samples import samples_of_cloud
from pipeline.view import View
from sim.optics import Optics
from sim.render import render_pair
from sim.rig import RigLayout
from sim.scenes import build

KNOCK = {"cx": 0.25, "rotation_y": np.deg2rad(0.01), "focal": 1e-4}


@pytest.mark.slow
def test_one_pair_brings_a_knocked_projector_back() -> None:
    layout, optics = RigLayout().scaled(0.5), Optics()
    true, pattern = layout.calibration_for(optics), layout.pattern()
    knocked = replace(true, projector=moved(true.projector, KNOCK))
    pair = render_pair(layout, build("spheres"), pattern, optics, seed=3)
    cloud = Reconstructor(knocked, pattern, layout.volume()).reconstruct(pair.left, pair.right)
    view = View.of(knocked, pattern, layout.volume(), Settings(), knocked.left_color, None)
    samples = samples_of_cloud(cloud, view.decode(pair.left), pattern, every=3)
    assert len(samples) > 5000
    assert spread(true.projector, samples).systematic_px < 0.02
    got = refine_projector(knocked, samples)
    assert got.before.systematic_px > 0.2
    assert got.after.systematic_px < 0.02
    surface = pair.truth_left.xyz[pair.truth_left.scorable][::40].astype(np.float64)
    columns = (got.calibration.projector.project(surface) - true.projector.project(surface))[:, 0]
    assert np.sqrt((columns**2).mean()) < 0.02
