"""Wrong points, false surfaces and rings on clouds whose errors are known."""

from __future__ import annotations

import numpy as np
import pytest

from sim.evaluate.point_errors import distance_to_edge, false_surfaces, point_errors, surface_labels
from sim.render.ground_truth import Truth

ROWS, COLUMNS = 40, 60
VOLUME = (1000.0, 2000.0)


def truth() -> Truth:
    """A plane at 1400 mm whose right third is a step of 50 mm back; everything measurable."""
    z = np.full((ROWS, COLUMNS), 1400.0, np.float32)
    z[:, 40:] = 1450.0
    v, u = np.mgrid[:ROWS, :COLUMNS].astype(np.float32)
    xyz = np.stack([(u - 30) * z / 3000, (v - 20) * z / 3000, z], axis=-1)
    all_of_it = np.ones((ROWS, COLUMNS), bool)
    return Truth(
        xyz, np.zeros((ROWS, COLUMNS, 2), np.float32), np.zeros((ROWS, COLUMNS), np.int16), all_of_it, all_of_it
    )


def sigma(mm: float = 0.1) -> np.ndarray:
    return np.full((ROWS, COLUMNS), mm, np.float32)


def test_the_truth_itself_is_without_fault():
    found = point_errors(truth().xyz, sigma(), truth(), VOLUME)
    assert (found.covered, found.wrong, found.false_surfaces) == (1.0, 0.0, 0)
    assert found.error_to_sigma == 0


def test_errors_as_large_as_sigma_give_one_in_every_ring():
    true = truth()
    ray = true.xyz / np.linalg.norm(true.xyz, axis=-1, keepdims=True)
    signs = np.where(np.indices((ROWS, COLUMNS)).sum(axis=0) % 2, 0.1, -0.1)[..., None]
    found = point_errors((true.xyz + signs * ray).astype(np.float32), sigma(), true, VOLUME)
    for ring in found.rings.values():
        assert ring.error_to_sigma == pytest.approx(1.0, rel=0.01)


def test_a_surface_at_a_wrong_depth_is_counted_once_with_its_points():
    xyz = truth().xyz.copy()
    xyz[5:12, 5:12, 2] += 60
    found = point_errors(xyz, sigma(), truth(), VOLUME)
    assert (found.false_surfaces, found.false_points) == (1, 49)
    assert found.wrong == pytest.approx(49 / (ROWS * COLUMNS))
    assert found.wrong_alone == found.wrong


def test_a_silhouette_that_bleeds_by_a_pixel_is_wrong_but_not_alone():
    xyz = truth().xyz.copy()
    xyz[:, 40, 2] = 1400.0
    found = point_errors(xyz, sigma(), truth(), VOLUME)
    assert found.wrong == pytest.approx(1 / COLUMNS)
    assert found.wrong_alone == 0
    assert found.false_surfaces == 0


def test_points_where_nothing_is_are_wrong_and_missing_points_are_not_covered():
    true, xyz = truth(), truth().xyz.copy()
    true.xyz[:4] = np.nan
    xyz[20:] = np.nan
    found = point_errors(xyz, sigma(), true, VOLUME)
    assert found.wrong == pytest.approx(4 / 20)
    assert found.covered == pytest.approx(16 / 36)


def test_surfaces_are_parted_by_steps_and_by_missing_points():
    depth = np.full((20, 30), 1400.0, np.float32)
    depth[:, 10:20] = 1402.9
    depth[:, 20:] = 1407.0
    assert len(np.unique(surface_labels(depth))) == 2
    depth[10] = np.nan
    assert len(np.unique(surface_labels(depth)[~np.isnan(depth)])) == 4
    assert false_surfaces(depth, depth > 1405) == [100, 90]


def test_the_distance_to_an_edge_is_one_beside_it():
    distance = distance_to_edge(truth(), truth().scorable)
    assert (distance[:, 39] == 1).all()
    assert (distance[:, 40] == 1).all()
    assert distance[20, 30] == pytest.approx(10, abs=0.5)
