"""The centroid of a circle's image: against a fine polygon, the ellipse of projective geometry, and its limits."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD
from pipeline.calibrate.targets.localise import circle_projection
from pipeline.rig.camera_model import CameraModel


def camera(distortion=(0.0, 0.0, 0.0, 0.0, 0.0)):
    return CameraModel((1024, 820), [[3400, 1.5, 505], [0, 3410, 415], [0, 0, 1]], distortion)


def pose(x_deg, y_deg, z_mm=1400.0):
    rotation = cv2.Rodrigues(np.radians([x_deg, 0, 0]))[0] @ cv2.Rodrigues(np.radians([0, y_deg, 5.0]))[0]
    return rotation, np.array([0, 0, z_mm]) - rotation @ DEFAULT_BOARD.points.mean(axis=0)


def polygon(device, rotation, translation, centre, radius, corners=4000):
    """Centroid and area of the image of a circle, from very many points on its edge."""
    angle = np.arange(corners) * 2 * np.pi / corners
    edge = centre + radius * np.stack([np.cos(angle), np.sin(angle), np.zeros(corners)], axis=1)
    seen = edge @ rotation.T + translation
    x, y = device.to_pixels(device.distort(seen[:, :2] / seen[:, 2:])).T
    origin = x.mean(), y.mean()
    x, y = x - origin[0], y - origin[1]
    cross = x * np.roll(y, -1) - np.roll(x, -1) * y
    area = cross.sum() / 2
    centroid = [((v + np.roll(v, -1)) * cross).sum() / (6 * area) for v in (x, y)]
    return np.add(centroid, origin), abs(area)


@pytest.mark.parametrize("distortion", [(0, 0, 0, 0, 0), (-0.3, 0.4, 0.003, -0.002, -0.5)])
@pytest.mark.parametrize("tilt", [(0, 0), (45, 0), (-30, 40), (60, 20)])
def test_centroids_and_areas_agree_with_a_fine_polygon(distortion, tilt):
    device, (rotation, translation) = camera(distortion), pose(*tilt)
    points = DEFAULT_BOARD.points[::7]
    centroids = circle_projection.centroids(device, rotation, translation, points, 10.0)
    areas = circle_projection.areas(device, rotation, translation, points, 10.0)
    for point, centroid, area in zip(points, centroids, areas, strict=True):
        expected, expected_area = polygon(device, rotation, translation, point, 10.0)
        assert centroid == pytest.approx(expected, abs=2e-5)
        assert area == pytest.approx(expected_area, rel=2e-6)


def test_without_distortion_the_centroid_is_the_centre_of_the_projected_conic():
    device, (rotation, translation) = camera(), pose(40, -25)
    for point, centroid in zip(
        DEFAULT_BOARD.points,
        circle_projection.centroids(device, rotation, translation, DEFAULT_BOARD.points, 10.0),
        strict=True,
    ):
        plane = np.column_stack([rotation[:, 0], rotation[:, 1], rotation @ point + translation])
        dual = device.matrix @ plane @ np.diag([100.0, 100.0, -1.0]) @ plane.T @ device.matrix.T
        assert centroid == pytest.approx(dual[:2, 2] / dual[2, 2], abs=1e-5)


def test_a_frontal_circle_and_a_circle_without_size_have_no_offset():
    device, (rotation, translation) = camera(), pose(0, 0)
    assert np.abs(circle_projection.offsets(device, rotation, translation, DEFAULT_BOARD.points, 10.0)).max() < 1e-9
    device, (rotation, translation) = camera((-0.3, 0.4, 0.003, -0.002, -0.5)), pose(30, 40)
    assert np.abs(circle_projection.offsets(device, rotation, translation, DEFAULT_BOARD.points, 0.0)).max() < 1e-9


def test_the_offset_grows_with_the_square_of_the_radius():
    device, (rotation, translation) = camera((-0.1, 0.1, 0, 0, 0)), pose(30, 40)
    small, large = (
        circle_projection.offsets(device, rotation, translation, DEFAULT_BOARD.points, r) for r in (5.0, 10.0)
    )
    assert np.abs(large - 4 * small).max() < 0.001 * np.abs(large).max()
    assert 0.03 < np.linalg.norm(large, axis=1).max() < 0.2


def test_the_diameter_comes_back_from_the_areas():
    device, (rotation, translation) = camera((-0.3, 0.4, 0.003, -0.002, -0.5)), pose(50, -20)
    areas = circle_projection.areas(device, rotation, translation, DEFAULT_BOARD.points, 9.5)
    areas[:5] = np.nan
    assert circle_projection.diameter_mm(areas, device, rotation, translation, DEFAULT_BOARD.points) == pytest.approx(
        19, rel=1e-9
    )
    assert np.isnan(
        circle_projection.diameter_mm(np.full(99, np.nan), device, rotation, translation, DEFAULT_BOARD.points)
    )


def test_behind_the_device_is_nan():
    device, (rotation, translation) = camera(), pose(0, 0, -500)
    assert np.isnan(circle_projection.centroids(device, rotation, translation, DEFAULT_BOARD.points, 10.0)).all()
