"""The map of a board into an image: exact for homographies, and good enough where a lens bends it."""

from __future__ import annotations

import numpy as np

from pipeline.calibrate.projector.plane_map import SmoothMap
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.geometry.homography import homography, mapped
from sim.boards.board_scene import BoardPose, true_centroids
from sim.rig.layout import RigLayout

MATRIX = np.array([[2.1, 0.1, 300.0], [-0.2, 1.9, 250.0], [4e-4, -3e-4, 1.0]])


def test_a_homography_is_recovered_despite_a_wrong_point() -> None:
    points = np.random.default_rng(0).uniform(-150, 170, (50, 2))
    image = mapped(MATRIX, points)
    image[7] += 80
    found, misfit = homography(points, image)
    np.testing.assert_allclose(found / found[2, 2], MATRIX, rtol=1e-6, atol=1e-9)
    assert misfit < 1e-6


def test_slopes_are_those_of_the_map() -> None:
    plane = DEFAULT_BOARD.points[:, :2]
    view = SmoothMap.fitted(plane, mapped(MATRIX, plane), np.ones(len(plane)))
    step = np.array([0.01, -0.02])
    np.testing.assert_allclose(view(plane + step) - view(plane), view.slope(plane) @ step, atol=1e-6)


def test_the_shift_of_centroids_is_that_of_the_true_rig() -> None:
    layout, pose = RigLayout(), BoardPose((0.0, 0.0, 0.0), (0.5, -0.5, 0.1))
    rotation, place = pose.in_world(DEFAULT_BOARD, layout)
    device = layout.calibration().left
    centroids, _ = true_centroids(device, DEFAULT_BOARD, rotation, place)
    centres = device.project(DEFAULT_BOARD.points @ rotation.T + place)
    plane = DEFAULT_BOARD.points[:, :2]
    view = SmoothMap.fitted(plane, centroids, np.ones(len(plane)))
    shift = centroids - centres
    assert np.abs(shift).max() > 0.05
    assert np.abs(view.centroid_shift(plane, 10.0) - shift).max() < 0.002
