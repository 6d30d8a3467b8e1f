"""Laws of the whole reconstruction, with the simulator's truth as the judge."""

import dataclasses

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError, ImageError, PipelineError
from pipeline.common.settings import LIMITS, Settings
from pipeline.geometry.triangulate import triangulate
from pipeline.pattern.color_fringe import modulated_profile
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration
from pipeline.rig.camera_model import CameraModel
from pipeline.rig.volume import Volume
from sim.evaluate.score import score
from sim.render.render_pair import render_counts, with_noise
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.renders import render_pair

SMALL = RigLayout().scaled(0.375)
SETTINGS = Settings(cluster_min_area=40)


def small_pattern(layout=SMALL, **options):
    return layout.pattern(36.0, **options)


@pytest.fixture(scope="module")
def pair():
    return render_pair(SMALL, build("mixed"), small_pattern(), Optics(), seed=1)


def reconstructor(layout=SMALL, optics=None, settings=SETTINGS, **options):
    optics = optics or Optics()
    return Reconstructor(
        layout.calibration_for(optics), small_pattern(layout), layout.volume(), settings=settings, **options
    )


@pytest.fixture(scope="module")
def cloud(pair):
    return reconstructor().reconstruct(pair.left, pair.right)


def test_a_scene_with_everything_is_measured(pair, cloud):
    found = score(cloud.xyz, pair.truth_left)
    # Edges weigh more in a small image than in a full one, whose promise is checked below.
    assert found.reconstructed > 0.915
    assert found.wrong < 0.015


def test_every_point_lies_on_its_pixels_ray(cloud):
    rays = SMALL.calibration().left.rays()
    valid = np.isfinite(cloud.xyz[..., 2])
    assert np.abs(cloud.xyz[valid][:, :2] / cloud.xyz[valid][:, 2:] - rays[valid]).max() < 1e-6


def test_unknown_is_nan_in_all_of_a_point_and_its_sigma(cloud):
    valid = np.isfinite(cloud.xyz[..., 2])
    assert np.isfinite(cloud.xyz[valid]).all()
    assert np.isnan(cloud.xyz[~valid]).all()
    assert (np.isfinite(cloud.sigma_mm) == valid).all()
    assert ((cloud.order >= 0) == valid).all()
    assert cloud.xyz.dtype == np.float32
    assert cloud.gray.dtype == np.uint8


@pytest.mark.parametrize(("near_mm", "far_mm"), [(1285.0, 1400.0), (1400.0, 1515.0)])
def test_there_is_no_point_beyond_either_limit_of_the_volume(pair, cloud, near_mm, far_mm):
    """But for 2 % of its extent; orders are searched farther, and surfaces there are matched."""
    z = cloud.xyz[..., 2]
    assert (z < near_mm).any() or (z > far_mm).any()
    calibration = SMALL.calibration_for(Optics())
    part = Reconstructor(calibration, small_pattern(), Volume(near_mm, far_mm), settings=SETTINGS)
    found = part.reconstruct(pair.left, pair.right)
    inside = np.isfinite(found.xyz[..., 2])
    share = (1 / found.xyz[inside][:, 2] - 1 / far_mm) / (1 / near_mm - 1 / far_mm)
    assert share.size > 5000 and share.min() > -0.021 and share.max() < 1.021
    assert ((found.order >= 0) == inside).all()


def test_orders_are_the_truths(pair, cloud):
    both = (cloud.order >= 0) & pair.truth_left.scorable
    # Measured orders belong to phases in (-pi, pi], the truth's to [0, 2 pi).
    turns = (pair.truth_left.projector[..., 0][both] + 0.5) * 36.0 / SMALL.projector_size[0]
    away = cloud.order[both] - np.rint(turns)
    # Noise may put a phase near pi on either side of it.
    certain = np.abs(turns - np.floor(turns) - 0.5) > 0.1
    assert (away[certain] == 0).mean() > 0.99
    assert np.isin(away[~certain], (-1, 0, 1)).mean() > 0.99


def test_the_point_solves_the_four_equations_of_both_views(cloud):
    calibration = SMALL.calibration_for(Optics())
    valid = np.argwhere(np.isfinite(cloud.xyz[..., 2]))[::97]
    points = cloud.xyz[valid[:, 0], valid[:, 1]].astype(float)
    left = valid[:, ::-1].astype(float)
    again = triangulate(calibration.left, calibration.right, left, calibration.right.project(points))
    assert np.abs(again - points).max() < 1e-3


@pytest.mark.threads
def test_the_result_does_not_depend_on_the_number_of_threads(pair, cloud):
    for threads in (1, 2):
        again = reconstructor(threads=threads).reconstruct(pair.left, pair.right)
        assert again.xyz.tobytes() == cloud.xyz.tobytes()
        assert again.sigma_mm.tobytes() == cloud.sigma_mm.tobytes()


def test_warming_up_leaves_no_trace(pair, cloud):
    warm = reconstructor()
    warm.warm_up()
    assert warm.reconstruct(pair.left, pair.right).xyz.tobytes() == cloud.xyz.tobytes()


def test_measuring_in_other_units_gives_the_same_shape(pair, cloud):
    calibration = SMALL.calibration_for(Optics())

    def larger(device: CameraModel) -> CameraModel:
        return dataclasses.replace(device, translation=2.5 * device.translation)

    scaled = Calibration(
        calibration.left, larger(calibration.right), larger(calibration.projector), calibration.left_color,
        calibration.right_color, calibration.response,
    )  # fmt: skip
    volume = SMALL.volume()
    big = Reconstructor(
        scaled, small_pattern(), Volume(2.5 * volume.near_mm, 2.5 * volume.far_mm), settings=SETTINGS
    ).reconstruct(pair.left, pair.right)
    both = np.isfinite(big.xyz[..., 2]) & np.isfinite(cloud.xyz[..., 2])
    assert both.sum() > 0.995 * cloud.points
    apart = np.abs(big.xyz[both] / 2.5 - cloud.xyz[both]).max(axis=1)
    assert np.quantile(apart, 0.9999) < 0.001
    # The right image's variance is that of the nearest pixel, which rounding may exchange for its neighbour; rounding
    # may also decide whether a pixel at a border is matched a third time. At borders sigma follows small differences
    # of depth. The surface's inclination is taken from places in the right image in eighths of a pixel.
    assert (apart < 0.5 * cloud.sigma_mm[both]).all()
    changes = np.abs(big.sigma_mm[both] / 2.5 / cloud.sigma_mm[both] - 1)
    assert np.quantile(changes, 0.999) < 1e-2
    assert np.mean(changes > 0.05) < 5e-4


def test_swapping_the_cameras_measures_the_same_surface(pair, cloud):
    calibration = SMALL.calibration_for(Optics())
    swapped = calibration.swapped()
    truth = pair.truth_right
    moved = truth.xyz.astype(float) @ calibration.right.rotation.T + calibration.right.translation
    volume = Volume(float(np.nanmin(moved[..., 2])) - 10, float(np.nanmax(moved[..., 2])) + 10)
    mirrored = Reconstructor(swapped, small_pattern(), volume, settings=SETTINGS).reconstruct(pair.right, pair.left)
    error = np.linalg.norm(mirrored.xyz - moved, axis=-1)
    scorable = truth.scorable
    right = (error < 1)[scorable].mean()
    assert right > 0.90
    left = score(cloud.xyz, pair.truth_left)
    assert np.sqrt((error[scorable & (error < 1)] ** 2).mean()) < 1.3 * left.rms_mm


def test_frequency_modulated_fringes_take_the_same_path():
    pattern = dataclasses.replace(small_pattern(), profile=modulated_profile(small_pattern().length, 36.0))
    pair = render_pair(SMALL, build("mixed"), pattern, Optics(), seed=2)
    found = Reconstructor(SMALL.calibration_for(Optics()), pattern, SMALL.volume(), settings=SETTINGS)
    measured = score(found.reconstruct(pair.left, pair.right).xyz, pair.truth_left)
    assert measured.reconstructed > 0.91
    assert measured.wrong < 0.002


def test_a_projector_off_by_a_column_is_noticed_and_corrected(pair, cloud):
    optics = Optics(projector_error_px=(0.375, 0.0))
    wrong = reconstructor(optics=optics)
    again = wrong.reconstruct(pair.left, pair.right)
    assert abs(wrong.correction[0] + 0.375) < 0.05
    assert again.points > 0.99 * cloud.points


def test_a_bayer_sensor_is_measured_without_demosaicing():
    layout = RigLayout().scaled(0.5)
    pattern = layout.pattern(48.0)
    pair = render_pair(layout, build("spheres"), pattern, Optics(), seed=3, encoding="bayer_grbg8")
    found = Reconstructor(
        layout.calibration_for(Optics()), pattern, layout.volume(), encoding="bayer_grbg8", settings=SETTINGS
    )
    measured = score(found.reconstruct(pair.left, pair.right).xyz, pair.truth_left)
    assert measured.reconstructed > 0.93


def test_nothing_in_the_dark_and_nothing_without_fringes():
    width, height = SMALL.calibration().left.size
    for level in (0, 6, 120, 255):
        flat = np.full((height, width, 3), level, np.uint8)
        assert reconstructor().reconstruct(flat, flat).points == 0


def test_pure_noise_is_not_a_surface():
    width, height = SMALL.calibration().left.size
    rng = np.random.default_rng(0)
    left, right = rng.integers(0, 255, (2, height, width, 3), dtype=np.uint8)
    assert reconstructor(settings=Settings()).reconstruct(left, right).points < 0.002 * width * height


def test_sigma_is_the_scatter_over_twenty_noisy_images():
    optics = Optics()
    counts = render_counts(SMALL, build("spheres"), small_pattern(), optics)
    found = reconstructor(settings=dataclasses.replace(SETTINGS, self_calibrate=False))
    clouds = []
    for seed in range(20):
        left, right = with_noise(counts, optics, seed, "rgb8")
        clouds.append(found.reconstruct(left, right))
    z = np.stack([c.xyz for c in clouds]).astype(float)
    always = np.isfinite(z[..., 2]).all(axis=0)
    assert always.mean() > 0.5
    scatter = np.linalg.norm(z[:, always].std(axis=0, ddof=1), axis=-1)
    predicted = np.mean([c.sigma_mm[always] for c in clouds], axis=0)
    assert 0.8 < np.median(predicted) / np.median(scatter) < 1.2
    for low, high in ((0, 33), (33, 66), (66, 100)):
        part = (predicted >= np.percentile(predicted, low)) & (predicted <= np.percentile(predicted, high))
        # In the upper third sigma holds the misfit that the textures show as well, which does not scatter.
        assert 0.8 < np.median(predicted[part]) / np.median(scatter[part]) < (1.2 if high < 100 else 1.6)


@pytest.mark.parametrize("columns", [-1.0, 1.0])
def test_a_projector_off_by_a_whole_column_costs_nothing(columns):
    optics, layout = Optics(projector_error_px=(columns, 0.0)), RigLayout().scaled(0.5)
    pair = render_pair(layout, build("steps"), layout.pattern(), Optics())
    found = Reconstructor(layout.calibration_for(optics), layout.pattern(), layout.volume())
    measured = score(found.reconstruct(pair.left, pair.right).xyz, pair.truth_left)
    assert abs(found.correction[0] + columns) < 0.05
    assert measured.reconstructed >= 0.97
    assert measured.wrong < 0.004


HALF = RigLayout().scaled(0.5)
PROMISES = [
    pytest.param("mixed", HALF, 0.935, 0.0035, 0.130),
    pytest.param("plane", HALF, 0.99, 0.0005, 0.050),
    pytest.param("mixed", RigLayout(projector_fraction=0.5).scaled(0.5), 0.90, 0.006, 0.130, marks=pytest.mark.long),
    pytest.param("mixed", RigLayout(), 0.965, 0.0008, 0.090, marks=pytest.mark.long),
    pytest.param("plane", RigLayout(), 0.99, 0.0005, 0.030, marks=pytest.mark.long),
    pytest.param("mixed", RigLayout(projector_fraction=0.5), 0.95, 0.0015, 0.090, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("scene", "layout", "reconstructed", "wrong", "rms_mm"), PROMISES)
def test_the_promise_at_half_and_full_size(scene, layout, reconstructed, wrong, rms_mm):
    pair = render_pair(layout, build(scene), layout.pattern(), Optics())
    found = Reconstructor(layout.calibration_for(Optics()), layout.pattern(), layout.volume())
    measured = score(found.reconstruct(pair.left, pair.right).xyz, pair.truth_left)
    assert measured.reconstructed >= reconstructed
    assert measured.wrong <= wrong
    assert measured.rms_mm <= rms_mm
    assert abs(measured.bias_mm) < 0.02


def test_images_that_do_not_fit_are_refused(pair):
    with pytest.raises(ImageError, match="left image"):
        reconstructor().reconstruct(pair.left[:-1], pair.right)
    with pytest.raises(ImageError, match="right image"):
        reconstructor().reconstruct(pair.left, pair.right.astype(np.uint16))
    with pytest.raises(ImageError, match="mono8"):
        reconstructor(encoding="mono8")


def test_a_pattern_of_another_projector_is_refused():
    pattern = RigLayout().scaled(0.25).pattern(24.0)
    with pytest.raises(CalibrationError, match=r"pattern\.size"):
        Reconstructor(SMALL.calibration(), pattern, SMALL.volume())


def test_a_volume_with_too_many_orders_is_refused_with_a_way_out():
    with pytest.raises(CalibrationError, match="make the volume smaller"):
        Reconstructor(SMALL.calibration(), SMALL.pattern(160.0), Volume(300.0, 90_000.0))


@pytest.mark.parametrize("limits", [(0, 10), (10, 10), (20, 10), (-5, 5), (1, float("inf"))])
def test_a_volume_that_is_none_is_refused(limits):
    with pytest.raises(PipelineError, match="volume"):
        Volume(*limits)


def test_settings_are_changed_by_name_and_checked():
    assert Settings().with_overrides({"min_modulation": 8}).min_modulation == 8.0
    for change, message in (
        ({"min_modulaton": 8}, "did you mean min_modulation"),
        ({"min_modulation": "8"}, "takes float"),
        ({"min_modulation": 1000.0}, "allowed"),
        ({"lattice_x": 2.5}, "takes int"),
        ({"self_calibrate": 1}, "takes bool"),
        ({"cluster_min_area": True}, "takes int"),
    ):
        with pytest.raises(PipelineError, match=message):
            Settings().with_overrides(change)
    assert set(LIMITS) == {f.name for f in dataclasses.fields(Settings) if f.type != "bool"}
