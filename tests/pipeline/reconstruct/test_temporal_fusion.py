"""Temporal fusion: noise falls at rest, what moves is the newest cloud; on the simulator and on synthetic planes."""

import functools

import numpy as np
import pytest

from pipeline.filter.cloud.temporal_fusion import TILE
from pipeline.reconstruct.cloud_filters import cloud_filters
from sim.rig.optics import Optics
from sim.scene.scene import Scene, board
from sim.scene.shapes import sphere
from tests.pipeline.reconstruct.test_cloud_filters import SIGMA, cloud, filters, noise, plane
from tests.pipeline.small import LAYOUT, PERIODS, SETTINGS, reconstructor
from tests.renders import render_pair

MM_PER_FRAME = 50 / 30
AT_REST = 4
BIAS_MM = 0.02


@functools.cache
def made():
    return reconstructor()


@functools.cache
def measured(x_mm, seed):
    """A sphere in front of a board; None: the board alone."""
    ball = () if x_mm is None else (sphere(48).placed((x_mm, 0, 0), albedo=0.8),)
    scene = Scene("moving sphere", (board(0.85), *ball))
    pair = render_pair(LAYOUT, scene, LAYOUT.pattern(PERIODS), Optics(), 0.0, seed)
    return made().reconstruct(pair.left, pair.right)


def test_a_simulated_scene_at_rest_gets_less_noise_and_a_moving_sphere_no_bias():
    fusion = cloud_filters(made().calibration, SETTINGS, mosaic=False, fuse=True)
    assert fusion is not None
    clouds = [measured(-60.0, seed) for seed in range(AT_REST)]
    for one in clouds[:-1]:
        fused = fusion.apply(one)
    last, known = clouds[-1], np.all([np.isfinite(one.sigma_mm) for one in clouds], axis=0)
    # The difference of two clouds has twice the variance of one, that of the mean of three and one 4/3 times.
    before, after = (np.std((one.xyz - last.xyz)[known][:, 2]) for one in (clouds[-2], fused))
    assert after / before == pytest.approx((4 / 3 / 2) ** 0.5, rel=0.05)
    # Clouds at rest differ by less than sigma, which contains errors that they share.
    assert 1 <= 3**0.5 * np.median(fused.sigma_mm[known] / clouds[-2].sigma_mm[known]) < 1.07
    board_only = measured(None, 50)
    for k in range(1, 3):
        one = measured(-60.0 + MM_PER_FRAME * k, 100 + k)
        fused = fusion.apply(one)
        on_sphere = one.xyz[..., 2] < board_only.xyz[..., 2] - 6
        off = (fused.xyz - one.xyz)[on_sphere][:, 2]
        assert on_sphere.sum() > 3000 and abs(off.mean()) < BIAS_MM and np.abs(off).max() < BIAS_MM
        assert (np.isfinite(fused.sigma_mm) == np.isfinite(one.sigma_mm)).all()
        on_board = np.isfinite(one.sigma_mm) & np.isfinite(board_only.sigma_mm) & ~on_sphere
        assert np.mean(fused.sigma_mm[on_board] < 0.7 * one.sigma_mm[on_board]) > 0.8


@pytest.mark.parametrize("n", [2, 8])
def test_noise_falls_with_the_root_of_the_number_of_clouds(n):
    fusion = filters(fuse=True, fusion_clouds=8)
    flat = plane((0.0, 0.0))
    for one in noise(5, n):
        out = fusion.apply(cloud(flat, one))
    error = out.xyz[..., 2] - flat
    at_rest = np.isfinite(out.sigma_mm) & (out.sigma_mm < SIGMA)
    assert at_rest.mean() > 0.98 and abs(error.mean()) < 5 * SIGMA / error.size**0.5
    assert error.std() == pytest.approx(SIGMA / n**0.5, rel=0.08)
    # The share of the variance that clouds do not have in common is measured to about a hundredth.
    assert np.median(out.sigma_mm) == pytest.approx(SIGMA / n**0.5, rel=0.04)


@pytest.mark.parametrize("repeated", [0.3, 0.7, 1.0])
def test_errors_that_every_cloud_has_stay_in_sigma(repeated):
    fusion, n = filters(fuse=True, fusion_clouds=8), 8
    flat = plane((0.0, 0.0))
    same = noise(20)[0] * repeated**0.5
    for one in noise(21, n):
        out = fusion.apply(cloud(flat, same + one * (1 - repeated) ** 0.5))
    expected = SIGMA * (repeated + (1 - repeated) / n) ** 0.5
    assert (out.xyz[..., 2] - flat).std() == pytest.approx(expected, rel=0.05)
    assert np.median(out.sigma_mm) == pytest.approx(expected, rel=0.05)


def test_points_that_come_and_go_at_the_border_of_a_surface_at_rest_do_not_end_its_fusion():
    """Of the tile at the border two columns belong to the surface, known in half of the clouds."""
    fusion, begin = filters(fuse=True), 2 * TILE - 2
    rng = np.random.default_rng(22)
    for one in noise(23, 6):
        seen = plane((0.0, 0.0))
        seen[:, :begin] = np.nan
        seen[:, begin : begin + 2][rng.random((len(seen), 2)) < 0.5] = np.nan
        out = fusion.apply(cloud(seen, one))
    assert (out.sigma_mm[:, 2 * TILE : 3 * TILE] < 0.5 * SIGMA).mean() > 0.95


def test_the_newest_cloud_keeps_its_share():
    """A surface that creeps by a tenth of sigma per cloud is followed at a distance of n clouds at most."""
    fusion = filters(fuse=True, fusion_clouds=4)
    creep = 0.1 * SIGMA
    for k in range(40):
        out = fusion.apply(cloud(plane((0.0, 0.0)) + creep * k))
    assert np.abs(out.xyz[..., 2] - plane((0.0, 0.0)) - creep * 39).max() < 4 * creep


def test_a_part_that_starts_to_move_is_free_at_once_and_the_rest_stays_fused():
    fusion = filters(fuse=True)
    flat = plane((0.0, 0.0))
    for one in noise(6, 4):
        fusion.apply(cloud(flat, one))
    moved = flat.copy()
    moved[:, 64:] -= 3 * SIGMA  # below what a single pixel shows
    new = cloud(moved, noise(7)[0])
    out = fusion.apply(new)
    assert (out.xyz[:, 64:] == new.xyz[:, 64:]).all() and (out.sigma_mm[:, 64:] == new.sigma_mm[:, 64:]).all()
    assert np.mean(out.sigma_mm[:, :48] < 0.5 * SIGMA) > 0.95


def test_unknown_points_stay_unknown_and_are_not_remembered():
    fusion = filters(fuse=True)
    flat = plane((0.0, 0.0))
    fusion.apply(cloud(flat, noise(8)[0]))
    holes = np.where(noise(9)[0] > 2, np.nan, flat)
    out = fusion.apply(cloud(holes, noise(9)[0]))
    assert (np.isnan(out.sigma_mm) == np.isnan(holes)).all()
    again = fusion.apply(cloud(flat, noise(10)[0]))
    assert (again.sigma_mm[np.isnan(holes)] == np.float32(SIGMA)).all()
