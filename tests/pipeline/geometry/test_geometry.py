"""Laws of the camera model, of triangulation and of the ray tables."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.common.errors import CalibrationError
from pipeline.common.jit import project
from pipeline.geometry.ray_tables import DepthScale, packed, ray_table
from pipeline.geometry.triangulate import triangulate
from pipeline.match.epipolar_search import pixel
from pipeline.rig.calibration import Calibration, ColorModel, from_mapping, to_mapping
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume
from tests.pipeline.rigs import camera, points, rig, rotation


def test_triangulation_inverts_projection_through_distortion_and_skew():
    calibration, world = rig(), points()
    left, right = calibration.left.project(world), calibration.right.project(world)
    assert np.abs(triangulate(calibration.left, calibration.right, left, right) - world).max() < 1e-6


def test_triangulation_splits_an_error_between_the_views_by_their_weights():
    calibration, world = rig(), points(50)
    left, right = calibration.left.project(world), calibration.right.project(world)
    off = left + np.array([0.0, 1.0])

    def error(weights):
        found = triangulate(calibration.left, calibration.right, off, right, weights=weights)
        return np.abs(calibration.left.project(found) - off)[:, 1].mean()

    assert error((10.0, 1.0)) < error((1.0, 1.0)) < error((1.0, 10.0))


@given(st.floats(-0.3, 0.3), st.floats(-0.5, 0.5), st.floats(-2e-3, 2e-3), st.floats(-2e-3, 2e-3))
@settings(max_examples=50, deadline=None)
def test_undistortion_inverts_distortion(k1, k2, p1, p2):
    model = CameraModel((100, 100), np.diag([500.0, 500.0, 1.0]), np.array([k1, k2, p1, p2, 0.0]))
    grid = np.stack(np.meshgrid(np.linspace(-0.2, 0.2, 9), np.linspace(-0.2, 0.2, 9)), axis=-1)
    assert np.abs(model.undistort(model.distort(grid)) - grid).max() < 1e-12


def test_rays_point_at_the_pixels_they_belong_to():
    left = rig().left
    rays = left.rays()
    points_ = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1) * 1400
    v, u = np.mgrid[0:205, 0:256]
    assert np.abs(left.project(points_) - np.stack([u, v], axis=-1)).max() < 1e-9


def test_the_kernels_projection_is_the_models():
    calibration, world = rig(), points(100)
    for device in (calibration.left, calibration.right, calibration.projector):
        found = np.array([project(packed(device), *p) for p in world])
        assert np.abs(found - device.project(world)).max() < 1e-9


def test_the_projection_of_the_match_along_a_ray_is_the_models():
    """By the inverse depth of a pixel's ray; compiled it is in single precision."""
    calibration, world = rig(), points(100)
    for device in (calibration.left, calibration.right, calibration.projector):
        found = np.array([pixel.py_func(packed(device), *(device.rotation @ p / p[2]), 1 / p[2]) for p in world])
        assert np.abs(found - device.project(world)).max() < 1e-9


def test_a_cropped_camera_sees_the_same_rays():
    left = rig().left
    part = left.cropped(40, 30, 100, 80)
    assert np.abs(part.rays() - left.rays()[30:110, 40:140]).max() < 1e-12


def test_swapping_the_cameras_moves_the_world_not_the_images():
    calibration, world = rig(), points(100)
    swapped = calibration.swapped()
    moved = world @ calibration.right.rotation.T + calibration.right.translation
    assert np.abs(swapped.left.project(moved) - calibration.right.project(world)).max() < 1e-9
    assert np.abs(swapped.right.project(moved) - calibration.left.project(world)).max() < 1e-9
    assert np.abs(swapped.projector.project(moved) - calibration.projector.project(world)).max() < 1e-9
    back = swapped.swapped()
    assert np.abs(back.right.rotation - calibration.right.rotation).max() < 1e-12
    assert np.abs(back.projector.translation - calibration.projector.translation).max() < 1e-9


@pytest.mark.parametrize("axis", ["x", "y"])
def test_ray_tables_follow_the_full_models_closely(axis):
    calibration, depth = rig(), DepthScale.of(Volume(1285, 1515))
    table = ray_table(calibration, depth, axis=axis, step=(8, 8))
    v, u = (table.sampled(plane) for plane in np.mgrid[: calibration.left.size[1], : calibration.left.size[0]])
    rays = calibration.left.normalise(np.stack([u, v], axis=-1).astype(float))
    direction = np.concatenate([rays, np.ones((*rays.shape[:2], 1))], axis=-1)
    for s in np.linspace(0, 1, 7):
        world = direction * depth.depth(s)
        projector, right = calibration.projector.project(world), calibration.right.project(world)
        first = 0 if axis == "x" else 1
        column = (table.along[0] + table.along[1] * s) / (1 + table.along[2] * s)
        m0, m1, m2, q0, q1, r0, r1 = table.lines
        main = (m0 + m1 * column) / (1 + m2 * column)
        found = column, r0 + r1 * column, main, q0 + q1 * main
        truths = projector[..., first], projector[..., 1 - first], right[..., first], right[..., 1 - first]
        # Across the growth of the phase whole pixels serve.
        for value, truth, most in zip(found, truths, (0.1, 0.2, 0.1, 0.2), strict=True):
            near = np.abs(truth - 140) < 150  # far outside the image no one asks
            assert np.abs(np.where(near, value - truth, 0)).max() < most


def test_a_calibration_survives_its_mapping():
    calibration = rig()
    again = from_mapping(to_mapping(calibration))
    for name in ("left", "right", "projector"):
        for key in ("matrix", "distortion", "rotation", "translation"):
            assert np.array_equal(getattr(getattr(again, name), key), getattr(getattr(calibration, name), key))
    assert np.array_equal(again.left_color.crosstalk, calibration.left_color.crosstalk)


def _broken(path, value):
    data = to_mapping(rig())
    at = data
    for key in path[:-1]:
        at = at[key]
    if value is None:
        del at[path[-1]]
    else:
        at[path[-1]] = value
    return data


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("cameras", "right", "rotation"), [[1, 0, 0], [0, 1, 0], [0, 0.1, 1]], "cameras.right.rotation is not a rot"),
        (("cameras", "right", "rotation"), [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "mirrors"),
        (("cameras", "left", "translation"), [1, 0, 0], "identity pose"),
        (("cameras", "left", "matrix"), [[1, 0], [0, 1]], "cameras.left.matrix has shape"),
        (("cameras", "left", "matrix"), [[-5, 0, 0], [0, 5, 0], [0, 0, 1]], "focal lengths"),
        (("cameras", "left", "distortion"), [0, 0, 0, 0], "cameras.left.distortion"),
        (("cameras", "left", "size"), [0, 10], "cameras.left.size"),
        (("cameras", "left", "size"), "wide", "cameras.left.size"),
        (("projector", "size"), None, "projector.size is missing"),
        (("cameras", "left", "color", "crosstalk"), [[2, 0, 0], [0, 1, 0], [0, 0, 1]], "ones on its diagonal"),
        (("cameras", "left", "color", "crosstalk"), [[1, 1, 1], [1, 1, 1], [1, 1, 1]], "cannot be inverted"),
        (("fringed_calibration",), 2, "version"),
        (("cameras", "right"), None, "cameras.right is missing"),
        (("cameras", "right", "matrix", 0, 0), float("nan"), "not finite"),
    ],
)
def test_an_inconsistent_calibration_is_rejected_with_its_key(path, value, message):
    with pytest.raises(CalibrationError, match=message):
        from_mapping(_broken(path, value))


def test_two_cameras_at_one_position_are_rejected():
    left = camera("left", (0, 0, 0), (0, 0, 0))
    with pytest.raises(CalibrationError, match="baseline"):
        Calibration(left, left, rig().projector)


def test_a_volume_behind_a_device_is_rejected():
    calibration = rig()
    behind = CameraModel(
        calibration.right.size, calibration.right.matrix, rotation=rotation(0, np.pi, 0),
        translation=np.array([0.0, 0, 10]), name="right",
    )  # fmt: skip
    broken = Calibration(calibration.left, behind, calibration.projector)
    with pytest.raises(CalibrationError, match="behind"):
        ray_table(broken, DepthScale.of(Volume(1000, 1500)), axis="x", step=(8, 8))


def test_unmixing_inverts_crosstalk():
    color = rig().left_color
    assert np.abs(color.unmix @ color.crosstalk - np.eye(3)).max() < 1e-12
    assert np.array_equal(ColorModel().unmix, np.eye(3))
