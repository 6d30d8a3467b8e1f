"""Laws of the cloud filters on synthetic surfaces with known noise, seen by a small camera."""

import functools

import numpy as np
import pytest

from pipeline.common.errors import PipelineError
from pipeline.common.settings import Settings
from pipeline.reconstruct.cloud import Cloud
from pipeline.reconstruct.cloud_filters import CloudFilters, cloud_filters
from pipeline.reconstruct.compilation import HEIGHT, WIDTH, small_rig
from pipeline.rig.pose import Pose

SIGMA = 0.05
INDEPENDENT = {"window_radius": 0}
CALIBRATION = small_rig()[0]
RAYS = CALIBRATION.left.rays()
V, U = np.mgrid[0:HEIGHT, 0:WIDTH]


def plane(tilt=(0.6, -0.3), distance=1200.0):
    """Depth (H, W) of the plane z = distance + tilt . (x, y)."""
    return distance / (1 - RAYS @ np.array(tilt))


def cloud(depth, noise=None, sigma=SIGMA):
    """Of a depth (H, W), NaN = unknown; noise (H, W) in standard deviations along the ray."""
    rays = np.concatenate([RAYS, np.ones((HEIGHT, WIDTH, 1))], axis=-1)
    length = np.linalg.norm(rays, axis=-1)
    noisy = depth if noise is None else depth + sigma * noise / length
    gray = np.full((HEIGHT, WIDTH), 80, np.uint8)
    order = np.where(np.isnan(depth), -1, 3).astype(np.int16)
    sigmas = np.where(np.isnan(depth), np.nan, sigma).astype(np.float32)
    return Cloud((rays * noisy[..., None]).astype(np.float32), sigmas, gray, (gray, gray), order)


@functools.cache
def noise(seed=0, count=1):
    return np.random.default_rng(seed).standard_normal((count, HEIGHT, WIDTH))


def filters(pose=None, fuse=False, **settings):
    made = cloud_filters(CALIBRATION, Settings(**settings), mosaic=False, pose=pose, fuse=fuse)
    assert isinstance(made, CloudFilters)
    return made


def off_plane(points, tilt=(0.6, -0.3), distance=1200.0):
    """Signed distance (...) from the plane, mm."""
    normal = np.array([-tilt[0], -tilt[1], 1.0])
    return (points @ normal - distance) / np.linalg.norm(normal)


def step():
    """A plane whose right half is 4 mm nearer."""
    return plane((0.0, 0.0)) - 4.0 * (U >= WIDTH // 2)


def test_without_a_filter_there_is_nothing_to_run():
    assert cloud_filters(CALIBRATION, Settings(), mosaic=False) is None
    assert cloud_filters(CALIBRATION, Settings(fusion_clouds=2), mosaic=True) is None


@pytest.mark.parametrize("n", [2, 3, 4])
def test_downsampling_keeps_a_plane(n):
    out = filters(downsampling=n).apply(cloud(plane()))
    assert out.xyz.shape == (HEIGHT // n, WIDTH // n, 3) and out.points == out.sigma_mm.size
    assert np.abs(off_plane(out.xyz.astype(float))).max() < 1e-3
    assert out.gray.shape == out.order.shape == out.sigma_mm.shape and (out.gray == 80).all()


@pytest.mark.parametrize("n", [2, 4])
def test_downsampling_divides_independent_noise_by_n(n):
    out = filters(downsampling=n, **INDEPENDENT).apply(cloud(plane((0.0, 0.0)), noise()[0]))
    error = off_plane(out.xyz.astype(float), (0.0, 0.0))
    # A point three sigmas from the tangent plane does not count: a few are left out.
    assert np.median(out.sigma_mm) == pytest.approx(SIGMA / n, rel=0.05)
    assert error.std() == pytest.approx(SIGMA / n, rel=0.12) and abs(error.mean()) < 4 * SIGMA / n / out.points**0.5


@pytest.mark.parametrize("options", [{"downsampling": 2}, {"downsampling": 4}, {"smoothing_sigma_px": 1.0}])
def test_sigma_accounts_for_the_correlation_of_the_noise(options):
    """Noise that passed the window of the phase fit is correlated: sigma falls by less, and as much as the error."""
    line = np.exp(-(np.array([-1, 0, 1]) ** 2) / 2)
    window = np.outer(line, line) / np.linalg.norm(np.outer(line, line))
    white = np.random.default_rng(3).standard_normal((HEIGHT + 2, WIDTH + 2))
    correlated = sum(window[i, j] * white[i : i + HEIGHT, j : j + WIDTH] for i in range(3) for j in range(3))
    out = filters(**options).apply(cloud(plane((0.0, 0.0)), correlated))
    inside = slice(4, -4), slice(4, -4)
    error = off_plane(out.xyz[inside].astype(float), (0.0, 0.0))
    assert error.std() == pytest.approx(np.median(out.sigma_mm[inside]), rel=0.15)
    assert np.median(out.sigma_mm) < 0.95 * SIGMA


def test_downsampling_does_not_mix_two_surfaces():
    out = filters(downsampling=3).apply(cloud(step(), 0.5 * noise()[0]))
    near, far = np.abs(out.xyz[..., 2] - 1196.0), np.abs(out.xyz[..., 2] - 1200.0)
    assert np.minimum(near, far).max() < 5 * SIGMA and (near < 1).any() and (far < 1).any()


def test_smoothing_leaves_a_tilted_plane_unbiased_up_to_its_border():
    means = []
    for one in noise(1, 60):
        out = filters_of_smoothing().apply(cloud(plane(), one))
        means.append(off_plane(out.xyz.astype(float)))
    mean = np.mean(means, axis=0)
    bound = 5 * SIGMA / 60**0.5
    assert np.abs(mean).max() < bound and abs(mean.mean()) < SIGMA / 100
    assert abs(mean[:, :2].mean()) < SIGMA / 20 and abs(mean[:2].mean()) < SIGMA / 20
    assert np.std(means) < 0.6 * SIGMA


@functools.cache
def filters_of_smoothing():
    return filters(smoothing_sigma_px=1.0, **INDEPENDENT)


def test_smoothing_keeps_steps_sharp_and_points_on_their_rays():
    noisy = cloud(step(), noise()[0])
    out = filters_of_smoothing().apply(noisy)
    assert np.abs(out.xyz[..., 2] - step()).max() < 5 * SIGMA
    assert np.std(out.xyz[..., 2] - step()) < 0.6 * SIGMA
    np.testing.assert_allclose(out.xyz[..., :2] / out.xyz[..., 2:], RAYS, atol=1e-6)


def test_filters_leave_the_measured_cloud_as_it_is():
    noisy = cloud(step(), noise()[0])
    before = noisy.xyz.tobytes(), noisy.sigma_mm.tobytes(), noisy.order.tobytes()
    out = filters(smoothing_sigma_px=1.0, hole_filling_size=3, noise_threshold_mm=0.01, downsampling=2).apply(noisy)
    assert (noisy.xyz.tobytes(), noisy.sigma_mm.tobytes(), noisy.order.tobytes()) == before
    assert out.measured is noisy and out.grid is not None and out.grid.xyz.shape == noisy.xyz.shape


def test_hole_filling_restores_a_tilted_plane_and_marks_what_it_fills():
    depth = plane()
    depth[20:24, 30:34] = depth[50, 60] = np.nan
    hole = np.isnan(depth)
    out = filters(hole_filling_size=4).apply(cloud(depth))
    assert out.interpolated is not None and (out.interpolated == hole).all() and out.points == depth.size
    assert np.abs(off_plane(out.xyz.astype(float))).max() < 1e-3 and (out.sigma_mm[hole] > 0).all()
    assert (out.order[hole] == -1).all()


def test_hole_filling_leaves_larger_holes_and_borders():
    depth = plane()
    depth[20:25, 30:35] = np.nan
    depth[:, :3] = depth[-2:] = np.nan
    out = filters(hole_filling_size=4).apply(cloud(depth, noise()[0]))
    assert out.interpolated is not None and not out.interpolated.any()
    assert (np.isnan(out.sigma_mm) == np.isnan(depth)).all()


@pytest.mark.parametrize("height", [1.0, 4.0, 60.0])
@pytest.mark.parametrize("edge", ["column", "diagonal"])
@pytest.mark.parametrize("tilt", [(0.0, 0.0), (0.5, 0.2)])
def test_hole_filling_never_bridges_two_surfaces(height, edge, tilt):
    line = U - WIDTH // 2 if edge == "column" else U - V - 8
    depth = plane(tilt) - height * (line >= 0)
    depth[np.abs(line) < 2] = np.nan
    holes = np.random.default_rng(4).random(depth.shape) < 0.02
    known = np.where(holes, np.nan, depth)
    out = filters(hole_filling_size=6).apply(cloud(known, 0.5 * noise()[0]))
    assert out.interpolated is not None
    gap = np.abs(line) < 2
    assert not out.interpolated[gap].any() and out.interpolated[~gap].sum() > 50
    filled = (out.interpolated == 1) & ~gap
    assert np.abs(out.xyz[..., 2] - depth)[filled].max() < 8 * SIGMA


def test_a_downsampled_block_counts_as_interpolated_where_nothing_in_it_was_measured():
    depth = plane()
    depth[20:24, 30:33] = np.nan
    out = filters(hole_filling_size=4, downsampling=2).apply(cloud(depth))
    assert out.interpolated is not None and np.argwhere(out.interpolated).tolist() == [[10, 15], [11, 15]]


def test_noise_and_outlier_thresholds_reject_single_points():
    one = cloud(plane((0.0, 0.0)))
    one.sigma_mm[10, 10] = 0.2
    one.xyz[30, 30] += 40.0
    rejected = np.argwhere(np.isnan(filters(noise_threshold_mm=0.1).apply(one).sigma_mm)).tolist()
    assert rejected == [[10, 10]]
    out = filters(outlier_threshold_mm=20.0).apply(one)
    assert np.argwhere(np.isnan(out.xyz[..., 2])).tolist() == [[30, 30]] and out.order[30, 30] == -1


def test_the_region_of_interest_is_a_box_in_the_output_frame_and_a_rectangle_of_the_image():
    pose = Pose(np.eye(3), np.array([1000.0, 0.0, 0.0]), "table")
    settings = {"roi_x_min_mm": 900.0, "roi_x_max_mm": 1100.0, "roi_row_max": 39, "roi_column_min": 20}
    out = filters(pose, **settings).apply(cloud(plane()))
    x = cloud(plane()).xyz[..., 0]
    inside = (np.abs(x) <= 100) & (V <= 39) & (U >= 20)
    assert (np.isfinite(out.sigma_mm) == inside).all() and out.frame == "table"
    assert out.xyz[inside][:, 0].min() >= 900 and out.grid is not None and out.grid.frame == "left"
    np.testing.assert_allclose(out.grid.xyz[inside][:, 0] + 1000, out.xyz[inside][:, 0], rtol=1e-6)


@pytest.mark.parametrize("name", ["roi_x_{}_mm", "roi_z_{}_mm", "roi_column_{}", "roi_row_{}"])
def test_a_region_inside_out_is_an_error_with_value_and_limit(name):
    least, most = name.format("min"), name.format("max")
    with pytest.raises(PipelineError, match=f"{least} is 50.*less than {most}, 20"):
        Settings().with_overrides({least: 50, most: 20})


@pytest.mark.parametrize(("name", "value"), [("downsampling", 0), ("fusion_clouds", 0), ("smoothing_sigma_px", -1.0)])
def test_a_size_of_none_is_an_error_with_value_and_limit(name, value):
    with pytest.raises(PipelineError, match=f"{name} is {value:g}.*allowed"):
        Settings().with_overrides({name: value})


def test_a_cloud_of_every_second_pixel_is_filtered_like_one_of_all():
    flat = cloud(plane((0.0, 0.0)), noise()[0])
    half = cloud(np.where((U % 2 == 0) & (V % 2 == 0), flat.xyz[..., 2], np.nan))
    out = filters(smoothing_sigma_px=1.0, hole_filling_size=4).apply(half, stride=2)
    known = np.isfinite(half.sigma_mm)
    assert (np.isfinite(out.sigma_mm) == known).all() and out.interpolated is not None and not out.interpolated.any()
    assert np.std(out.xyz[known][:, 2]) < 0.7 * np.std(half.xyz[known][:, 2])
