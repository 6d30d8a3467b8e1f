"""Epipolar distances and differences of models."""

from dataclasses import replace

import numpy as np

from pipeline.calibrate.bundle import calibrate
from pipeline.calibrate.bundle.adjust.state import rotation_matrices
from pipeline.calibrate.bundle.quality.reprojection_error import difference_px, epipolar_distances, rms
from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from sim.rig.layout import RigLayout
from tests.pipeline.calibrate.bundle.sessions import session

RIG = RigLayout().calibration()


def test_rms_counts_both_coordinates():
    assert rms(np.array([[3.0, 4.0], [0.0, 5.0]])) == 5.0
    assert np.isnan(rms(np.zeros((0, 2))))


def test_points_lie_on_their_epipolar_lines_and_a_shift_across_them_is_the_distance():
    rng = np.random.default_rng(0)
    points = rng.uniform((-150, -120, 1300), (150, 120, 1500), (50, 3))
    a, b = RIG.left.project(points), RIG.right.project(points)
    assert epipolar_distances(RIG.left, RIG.right, a, b).max() < 1e-9
    away = epipolar_distances(RIG.left, RIG.right, a, b + np.array([0, 0.3]))
    # The lines are nearly level, so a shift in v is nearly a distance, in both images.
    assert np.abs(away - 0.3).max() < 0.03


def test_equal_models_do_not_differ_and_a_rotation_is_removed():
    assert np.abs(difference_px(RIG.left, RIG.left)).max() < 1e-9
    matrix = RIG.left.matrix.copy()
    matrix[0, 2] += 1.0
    shifted = replace(RIG.left, matrix=matrix)
    assert np.abs(difference_px(RIG.left, shifted, rotation_removed=False)[..., 0] - 1).max() < 1e-9
    # A shift of 1 px is a rotation of 1 / 3413 rad up to perspective and distortion.
    assert np.abs(difference_px(RIG.left, shifted)).max() < 0.03
    rotation = rotation_matrices(np.array([[1e-4, -2e-4, 3e-4]]))[0]
    assert np.abs(difference_px(RIG.left, replace(RIG.left, rotation=rotation))).max() < 1e-9


def test_distortion_is_accurate_to_hundredths_of_a_pixel_although_its_coefficients_are_not():
    views, sizes, truth = session(sigma=0.02, seed=4)
    solution = calibrate(DEFAULT_BOARD, views, sizes)
    assert solution.sigma["left.k3"] > 2
    for name, model in solution.devices.items():
        away = np.linalg.norm(difference_px(truth[name], model), axis=-1)
        middle = away[4:-4, 5:-5]
        assert middle.max() < 0.03 and np.median(away) < 0.03 and away.max() < 0.15, (name, away.max())
