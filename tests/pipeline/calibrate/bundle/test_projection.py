"""The projection is the camera model's, and its derivatives are the limits of differences."""

import numpy as np
import pytest

from pipeline.calibrate.bundle.adjust.projection import project, project_with_slopes
from pipeline.calibrate.bundle.adjust.state import PER_DEVICE, PER_VIEW, State, intrinsics_of, rotation_matrices
from pipeline.calibrate.bundle.adjust.uncertainty import left_jacobian_inverse, rotation_vector
from pipeline.calibrate.targets.board.board import Board
from pipeline.rig.camera_model import CameraModel

BOARD = Board("circles", 5, 4, 40.0)


def state(seed: int) -> State:
    """Three devices with every parameter in use, four views."""
    rng = np.random.default_rng(seed)
    intrinsics = [
        [rng.uniform(600, 4000), rng.uniform(600, 4000), rng.uniform(-5, 5), *rng.uniform(300, 700, 2),
         *rng.uniform(-0.2, 0.2, 2), *rng.uniform(-2e-3, 2e-3, 2), rng.uniform(-0.1, 0.1)]
        for _ in range(3)
    ]  # fmt: skip
    turns = rotation_matrices(0.3 * rng.standard_normal((7, 3)))
    shifts = np.concatenate([100 * rng.standard_normal((3, 3)), rng.uniform((-60, -60, 900), (60, 60, 1400), (4, 3))])
    points = BOARD.points + rng.standard_normal(BOARD.points.shape)
    return State(np.array(intrinsics), turns[:3], shifts[:3], turns[3:], shifts[3:], points)


def everywhere(s: State) -> tuple[np.ndarray, ...]:
    device, view, mark = np.mgrid[0 : s.devices, 0 : s.views, 0 : len(s.points)].reshape(3, -1)
    return device, view, mark


@pytest.mark.parametrize("seed", range(4))
def test_pixels_are_those_of_the_camera_model(seed):
    s = state(seed)
    device, view, mark = everywhere(s)
    pixels = project(s, device, view, mark)
    for k in range(3):
        model = s.model(k, "any", (1000, 800))
        assert np.allclose(intrinsics_of(model), s.intrinsics[k], atol=0)
        for v in range(4):
            world = s.points @ s.view_rotations[v].T + s.view_translations[v]
            assert np.abs(model.project(world) - pixels[(device == k) & (view == v)]).max() < 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_derivatives_are_the_limits_of_differences(seed):
    s = state(seed)
    index = everywhere(s)
    slopes = project_with_slopes(s, *index)
    assert np.abs(slopes.pixels - project(s, *index)).max() < 1e-9
    device, view, mark = index
    d, v = PER_DEVICE * s.devices, PER_VIEW * s.views
    size = np.concatenate([np.tile([1, 1, 1, 1, 1, 1e-3, 1e-3, 1e-4, 1e-4, 1e-3, *[1e-5] * 3, *[1e-2] * 3], 3)])
    size = np.concatenate([size, np.tile([*[1e-5] * 3, *[1e-2] * 3], 4), np.full(3 * len(s.points), 1e-2)])
    for k, step in enumerate(size):
        change = np.zeros(len(size))
        change[k] = step
        numeric = (project(s.stepped(change), *index) - project(s.stepped(-change), *index)) / (2 * step)
        analytic = np.zeros_like(numeric)
        if k < d:
            chosen = device == k // PER_DEVICE
            analytic[chosen] = slopes.of_device[chosen, :, k % PER_DEVICE]
        elif k < d + v:
            chosen = view == (k - d) // PER_VIEW
            analytic[chosen] = slopes.of_view[chosen, :, (k - d) % PER_VIEW]
        else:
            chosen = mark == (k - d - v) // 3
            analytic[chosen] = slopes.of_point[chosen, :, (k - d - v) % 3]
        assert np.abs(numeric - analytic).max() < 2e-6 * max(1.0, np.abs(analytic).max()), k


def test_a_mark_behind_a_device_has_no_pixels():
    s = state(0)
    behind = s.with_views(s.view_rotations, -s.view_translations)
    index = everywhere(behind)
    assert np.isnan(project(behind, *index)).all()
    assert np.isnan(project_with_slopes(behind, *index).pixels).all()


@pytest.mark.parametrize("seed", range(6))
def test_rotation_vectors_are_those_of_the_matrices_up_to_half_a_turn(seed):
    rng = np.random.default_rng(seed)
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    for angle in (0.0, 1e-9, 1e-3, 1.0, 3.0, np.pi - 1e-3):
        matrix = rotation_matrices((angle * axis)[None])[0]
        assert np.abs(matrix @ matrix.T - np.eye(3)).max() < 1e-12
        assert np.abs(rotation_vector(matrix) - angle * axis).max() < 1e-9


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.4, 2.0])
def test_the_derivative_of_the_rotation_vector_is_the_limit_of_differences(angle):
    vector = angle * np.array([0.48, -0.6, 0.64])
    matrix, analytic = rotation_matrices(vector[None])[0], left_jacobian_inverse(vector)
    for k in range(3):
        step = 1e-6 * np.eye(3)[k]
        ahead = rotation_vector(rotation_matrices(step[None])[0] @ matrix)
        back = rotation_vector(rotation_matrices(-step[None])[0] @ matrix)
        assert np.abs((ahead - back) / 2e-6 - analytic[:, k]).max() < 1e-6


def test_a_model_from_a_state_is_accepted_as_a_rotation():
    assert isinstance(state(3).model(1, "right", (640, 480)), CameraModel)
