"""Laws of lying fringes: a rig mirrored at the diagonal measures what the upright one does."""

import numpy as np
import pytest

from sim.evaluate.score import score
from tests.pipeline.small import images, pair, reconstructor, upright


@pytest.mark.parametrize("scene", ["mixed", "moving", "plane"])
def test_a_mirrored_rig_measures_the_same(scene):
    rendered = pair(scene)
    standing, lying = (reconstructor(axis) for axis in "xy")
    one, other = standing.reconstruct(*images(rendered)), lying.reconstruct(*images(rendered, "y"), stride=1)
    xyz, order = upright(other, "y")
    assert np.abs(standing.correction[0] - lying.correction[0]) < 0.02
    both = (one.order >= 0) & (order >= 0)
    assert (one.order == order)[both].mean() > 0.998
    away = np.linalg.norm(one.xyz[both] - xyz[both], axis=-1) / one.sigma_mm[both]
    assert np.median(away) < 0.5
    first, second = score(one.xyz, rendered.truth_left), score(xyz, rendered.truth_left)
    assert abs(first.reconstructed - second.reconstructed) < 0.01
    assert second.wrong < first.wrong + 0.002
    assert second.rms_mm < 1.05 * first.rms_mm
