"""Laws of the cloud on every second pixel of every second row."""

import functools

import numpy as np
import pytest

from sim.evaluate.score import RIGHT_MM, score
from tests.pipeline.small import images, pair, reconstructor, same, upright

AXES = pytest.mark.parametrize("axis", ["x", "y"])
SCENES = pytest.mark.parametrize("scene", ["mixed", "moving"])


@functools.cache
def clouds(axis, scene):
    """The cloud of all pixels and that of every second one."""
    rendered, found = pair(scene), reconstructor(axis)
    full = found.reconstruct(*images(rendered, axis))
    return full, found.reconstruct(*images(rendered, axis), stride=2)


@AXES
@SCENES
def test_points_stand_only_on_even_rows_and_columns(axis, scene):
    full, half = clouds(axis, scene)
    odd = np.ones(half.order.shape, bool)
    odd[::2, ::2] = False
    assert half.xyz.shape == full.xyz.shape
    assert np.isnan(half.xyz[odd]).all()
    assert np.isnan(half.sigma_mm[odd]).all()
    assert (half.order[odd] < 0).all()


@AXES
@SCENES
def test_they_are_the_full_clouds_points_within_the_noise(axis, scene):
    full, half = clouds(axis, scene)
    both = (full.order >= 0) & (half.order >= 0)
    assert (full.order == half.order)[both].mean() > 0.999
    away = np.linalg.norm(full.xyz[both] - half.xyz[both], axis=-1) / full.sigma_mm[both]
    assert np.median(away) < 0.1
    assert (away < 1).mean() > 0.99
    # Bends of the depth (see pipeline.filter.depth_bends) are those between points two pixels apart.
    assert np.median(np.abs(half.sigma_mm[both] / full.sigma_mm[both] - 1)) < 0.02


@AXES
@SCENES
def test_they_cover_about_as_much_and_err_as_seldom(axis, scene):
    rendered = pair(scene)
    full, half = (upright(cloud, axis)[0] for cloud in clouds(axis, scene))
    truth, part = rendered.truth_left, np.s_[::2, ::2]
    scorable = truth.scorable[part]

    def covered(xyz):
        error = np.linalg.norm(xyz[part] - truth.xyz[part], axis=-1)
        return (error < RIGHT_MM)[scorable].mean()

    # Borders are twice as wide for the gates, and this small image has many: up to nine points are theirs.
    assert abs(covered(half) - covered(full)) < 0.1
    assert score(half, truth).wrong < score(full, truth).wrong + 0.002


@AXES
def test_resolutions_may_alternate(axis):
    full, half = clouds(axis, "mixed")
    found, shown = reconstructor(axis), images(pair("mixed"), axis)
    for _ in range(2):
        assert same(found.reconstruct(*shown, stride=2), half)
        assert same(found.reconstruct(*shown), full)


@pytest.mark.parametrize("stride", [0, 3])
def test_another_stride_is_an_error(stride):
    shown = images(pair("mixed"))
    with pytest.raises(ValueError, match=f"stride is {stride}, expected 1 or 2"):
        reconstructor().reconstruct(*shown, stride=stride)
