import numba
import numpy as np
import pytest

from pipeline.attributes.normals import normals_of
from sim.render.lens import packed, pixel_rays
from sim.scene.named_scenes import build
from sim.scene.ray_hits import surfaces
from tests.pipeline.rigs import rotation
from tests.pipeline.small import LAYOUT, images, pair, reconstructor

HEIGHT, WIDTH = 120, 300
PITCH = 0.4


def rays():
    """Rays of a camera with square pixels 0.4 mm apart at one metre, (H, W, 3)."""
    v, u = np.indices((HEIGHT, WIDTH))
    x, y = PITCH / 1000 * (u - WIDTH / 2), PITCH / 1000 * (v - HEIGHT / 2)
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def unit(*vector):
    return np.array(vector) / np.linalg.norm(vector)


def plane(normal, depth_mm=1000.0):
    """Points of the plane with this normal through the middle of the image."""
    z = depth_mm * normal[2] / (rays() @ normal)
    return (rays() * z[..., None]).astype(np.float32)


def sphere(radius_mm, depth_mm=1000.0):
    """Points and normals of a sphere, NaN beside it."""
    centre = np.array([0.0, 0.0, depth_mm])
    a, b, c = np.sum(rays() ** 2, -1), rays() @ centre, centre @ centre - radius_mm**2
    with np.errstate(invalid="ignore"):
        z = (b - np.sqrt(b * b - a * c)) / a
    points = rays() * z[..., None]
    return points.astype(np.float32), (points - centre) / radius_mm


def sigma_of(points, sigma_mm=0.02):
    return np.where(np.isfinite(points[..., 2]), sigma_mm, np.nan).astype(np.float32)


def degrees(found, expected):
    return np.degrees(np.arccos(np.clip(np.sum(found * expected, axis=-1), -1, 1)))


def noisy(points, sigma_mm, seed=0):
    noise = sigma_mm * np.random.default_rng(seed).standard_normal(points.shape[:2])
    return (points * (1 + noise[..., None] / 1000)).astype(np.float32)


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, -0.3, -0.8), (-0.9, 0.1, -0.5), (0.2, 0.9, -0.4)])
def test_a_plane_has_its_normal_everywhere(normal):
    points = plane(unit(*normal))
    found = normals_of(points, sigma_of(points))
    assert np.isfinite(found).all()
    assert degrees(found, unit(*normal)).max() < 0.1
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-5)


def test_a_sphere_has_radial_normals_that_point_to_the_camera():
    points, radial = sphere(20.0)
    found = normals_of(points, sigma_of(points))
    steep = degrees(radial, [0, 0, -1])
    assert degrees(found, radial)[steep < 60].max() < 1.0
    assert np.nanmean(degrees(found, radial)[steep < 60]) < 0.3
    known = np.isfinite(found[..., 2])
    assert known.sum() > 0.9 * np.isfinite(points[..., 2]).sum()
    assert (np.sum(found * points, axis=-1)[known] < 0).all()


def test_normals_turn_with_the_points():
    points, radial = sphere(20.0)
    turn, sigma = rotation(0.4, -1.0, 2.0), sigma_of(points)
    found = normals_of(points, sigma)
    turned = normals_of((points @ turn.T + [10, -20, 30]).astype(np.float32), sigma)
    facing = radial[..., 2] < -0.5
    np.testing.assert_allclose(turned[facing], (found @ turn.T)[facing], atol=2e-3)


def test_noise_gives_the_error_of_a_weighted_fit():
    normal, sigma = unit(0.2, 0.1, -1), 0.03
    found = normals_of(noisy(plane(normal), sigma), sigma_of(plane(normal), sigma))
    # Slope of a line through 7 x 7 samples one pixel apart, in both directions.
    expected = np.degrees(sigma / PITCH / np.sqrt(7 * 28)) * np.sqrt(np.pi / 2)
    inner = degrees(found, normal)[4:-4, 4:-4]
    assert 0.7 * expected < inner.mean() < 1.15 * expected


def test_uncertain_points_count_less():
    points, sigma = plane(unit(0, 0, -1)), np.full((HEIGHT, WIDTH), 0.02, np.float32)
    points[50:53, 100:103] *= np.float32(1.0002)
    wrong = degrees(normals_of(points, sigma), [0, 0, -1])
    sigma[50:53, 100:103] = 2.0
    weighted = degrees(normals_of(points, sigma), [0, 0, -1])
    around = np.ones_like(wrong, bool)
    around[50:53, 100:103] = False
    assert weighted[around].max() < 0.05 < 2 < wrong[around].max()


def test_neither_side_of_a_step_takes_part_in_the_other():
    low, high = unit(0.3, 0.0, -1), unit(-0.3, 0.2, -1)
    points = plane(low)
    points[:, 150:] = plane(high, 1060.0)[:, 150:]
    points[60:, :150] = plane(low, 1030.0)[60:, :150]
    found = normals_of(noisy(points, 0.001), sigma_of(points, 0.005))
    expected = np.where((np.arange(WIDTH) < 150)[None, :, None], low, high)
    assert degrees(found, expected).max() < 1.0


def test_an_edge_between_faces_is_kept_to_a_pixel():
    faces = unit(0.6, 0, -1), unit(-0.6, 0, -1)
    left, right = plane(faces[0]), plane(faces[1])
    points = np.where((np.arange(WIDTH) < 150)[None, :, None], left, right)
    found = normals_of(points, sigma_of(points, 0.01))
    assert degrees(found[:, :148], faces[0]).max() < 0.2
    assert degrees(found[:, 153:], faces[1]).max() < 0.2


def test_lonely_points_and_unknown_ones_have_no_normal():
    points, full = np.full((HEIGHT, WIDTH, 3), np.nan, np.float32), plane(unit(0, 0, -1))
    assert np.isnan(normals_of(points, sigma_of(points))).all()
    points[10, 10], points[40, 20:90], points[80:90, 30:40] = full[10, 10], full[40, 20:90], full[80:90, 30:40]
    known = np.isfinite(normals_of(points, sigma_of(points))[..., 2])
    assert known[80:90, 30:40].all() and known.sum() == 100


def test_a_small_object_that_a_coarse_sample_misses_has_normals():
    normal = unit(0.2, 0.1, -1)
    points, full = np.full((HEIGHT, WIDTH, 3), np.nan, np.float32), plane(normal)
    points[81:88, 33:40] = full[81:88, 33:40]
    found = normals_of(points, sigma_of(points))
    assert np.isfinite(found[..., 2]).sum() == 49
    assert degrees(found[81:88, 33:40], normal).max() < 0.1


def test_an_uneven_border_does_not_tilt_a_plane():
    """Rows whose mean columns differ: the slope along the rows must not enter the one across them."""
    normal = unit(0.5, -0.3, -0.8)
    points = plane(normal)
    rows, columns = np.indices((HEIGHT, WIDTH))
    points[columns < 40 + 0.7 * rows] = np.nan
    found = normals_of(points, sigma_of(points))
    known = np.isfinite(found[..., 2])
    assert known.sum() > 0.99 * np.isfinite(points[..., 2]).sum()
    assert degrees(found, normal)[known].max() < 0.1


def test_a_stride_gives_the_normals_of_these_pixels():
    points = noisy(plane(unit(0.3, -0.2, -1)), 0.02)
    sigma = sigma_of(points)
    sparse, sparse_sigma = np.full_like(points, np.nan), np.full_like(sigma, np.nan)
    sparse[::2, ::2], sparse_sigma[::2, ::2] = points[::2, ::2], sigma[::2, ::2]
    found = normals_of(sparse, sparse_sigma, stride=2)
    np.testing.assert_array_equal(found[::2, ::2], normals_of(points[::2, ::2], sigma[::2, ::2]))
    assert np.isnan(found[1::2]).all() and np.isnan(found[:, 1::2]).all()


@pytest.mark.threads
def test_the_number_of_threads_changes_no_bit_and_a_read_only_cloud_is_no_other():
    points = noisy(sphere(20.0)[0], 0.02)
    sigma = sigma_of(points)
    found = []
    before = numba.get_num_threads()
    for threads in (1, before):
        numba.set_num_threads(threads)
        found.append(normals_of(points, sigma).tobytes())
    points.setflags(write=False)
    sigma.setflags(write=False)
    assert {normals_of(points, sigma).tobytes()} == set(found)


def test_a_measured_scene_has_the_normals_of_its_surfaces():
    """Spheres and planes of the simulator: without the pixels whose window reaches another surface."""
    camera = LAYOUT.calibration().left
    rows, columns = camera.size[1], camera.size[0]
    hits = surfaces(build("spheres"), 0.0, LAYOUT.stage_pose()).hits(
        camera.centre, pixel_rays(packed(camera), 0, rows, columns, 1.0, 0.0, 0.0)
    )
    truth, which = hits.normals.reshape(rows, columns, 3), hits.which.reshape(rows, columns)
    cloud = reconstructor().reconstruct(*images(pair("spheres")))
    error = degrees(normals_of(cloud.xyz, cloud.sigma_mm), truth)
    window = np.lib.stride_tricks.sliding_window_view(np.pad(which, 3, mode="edge"), (7, 7))
    inside = (window == which[..., None, None]).all(axis=(2, 3)) & np.isfinite(error)
    for shape, limit in ((0, 1.0), (1, 2.0), (3, 2.0)):
        assert (inside & (which == shape)).sum() > 1000
        assert error[inside & (which == shape)].mean() < limit
