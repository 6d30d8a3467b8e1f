"""Rigid poses: rotations keep distances, points and normals follow, everything else is refused."""

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError
from pipeline.rig.pose import Pose


def matrix(angle=0.7, translation=(100.0, -20.0, 3000.0)):
    c, s = np.cos(angle), np.sin(angle)
    out = np.eye(4)
    out[:3, :3] = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    out[:3, 3] = translation
    return out


def test_points_follow_and_normals_are_rotated_only():
    pose = Pose.of_matrix(matrix().tolist(), "table")
    points = np.random.default_rng(0).uniform(-500, 500, (7, 5, 3)).astype(np.float32)
    points[2, 2] = np.nan
    moved = pose.points(points)
    expected = points @ matrix()[:3, :3].T + matrix()[:3, 3]
    np.testing.assert_allclose(moved, expected, atol=1e-3)
    assert np.isnan(moved[2, 2]).all() and moved.dtype == np.float32
    normals = points / np.linalg.norm(points, axis=-1, keepdims=True)
    turned = pose.normals(normals)
    np.testing.assert_allclose(
        (turned[0, 0] * (moved[0, 1] - moved[0, 0])).sum(), (normals[0, 0] * (points[0, 1] - points[0, 0])).sum(),
        rtol=1e-4,
    )  # fmt: skip


def test_a_matrix_with_few_digits_becomes_a_rotation():
    pose = Pose.of_matrix(np.round(matrix(), 5).tolist(), "table")
    assert np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max() < 1e-12


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ((np.diag([1, 1, 1.01, 1])).tolist(), "not rigid: .* by 0.0201, limit 0.0001"),
        ((np.diag([1, 1, -1, 1])).tolist(), "mirrors"),
        (np.eye(3).tolist(), r"four rows of four numbers, it has the shape \[3, 3\]"),
        ([[1, 2], [3]], "four rows of four numbers"),
        ([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 2]], "last row"),
        ([[1, 0, 0, 1e9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], r"1e\+09 mm, limit 100000 mm"),
        ([[1, 0, 0, float("nan")], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]], "finite"),
    ],
)
def test_a_pose_that_is_not_rigid_is_refused_with_value_and_limit(rows, message):
    with pytest.raises(CalibrationError, match=message):
        Pose.of_matrix(rows, "table", name="outputs.frame")
