"""The scenes of the motion benchmark move by what its table names."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy.motion import measured, moving
from benchmarks.reconstruction.cases import HARD, scaled
from sim.scene.named_scenes import build

EXPOSURE_S = 0.008


@pytest.mark.parametrize("distance_mm", [1.0, 8.0])
def test_shapes_pass_their_places_at_time_0_and_move_by_the_distance_in_an_exposure(distance_mm: float):
    scene = build("mixed")
    moved = moving(scene, distance_mm, EXPOSURE_S)
    distances = []
    for shape, original in zip(moved.shapes, scene.shapes, strict=True):
        np.testing.assert_allclose(shape.pose(moved.share(0.0))[1], original.pose(0.0)[1], atol=1e-9)
        first, last = (shape.pose(moved.share(sign * EXPOSURE_S / 2))[1] for sign in (-1, 1))
        distances.append(np.linalg.norm(last - first))
    assert sorted(distances)[0] == 0.0  # the wall
    np.testing.assert_allclose(sorted(distances)[1:], distance_mm, rtol=1e-4)


def test_a_scene_that_rests_is_unchanged():
    assert moving(build("mixed"), 0.0, EXPOSURE_S) == build("mixed")


def test_a_slow_motion_costs_nothing_and_a_fast_one_coverage():
    case = scaled(HARD[0], 0.25)
    rest, slow, fast = (measured(case, distance) for distance in (0.0, 1.0, 8.0))
    assert slow.covered > rest.covered - 0.02
    assert fast.covered < slow.covered - 0.01
    assert max(found.wrong for found in (rest, slow, fast)) < 0.01
