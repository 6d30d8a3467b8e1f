"""Unequal responses of the cameras, which the calibration does not know, are measured and corrected."""

import cv2
import numpy as np
import pytest

from sim.evaluate.point_errors import point_errors
from sim.render.render_pair import render_counts, truths, with_noise
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.pipeline.small import LAYOUT, PERIODS, SETTINGS, reconstructor
from tests.renders import stored

GAINS = np.array([1.25, 1.0, 0.8], np.float32)


def _light(scene):
    pattern = LAYOUT.pattern(PERIODS)
    return render_counts(LAYOUT, build(scene), pattern, Optics()), truths(LAYOUT, build(scene), pattern)[0]


def _pair(scene, change=lambda counts: counts):
    """A pair with its truth whose right image (H, W, 3) is changed before the noise."""
    (left, right), truth = stored(_light, scene)
    return *with_noise((left, change(right)), Optics(), 3, "rgb8"), truth


def _measured(left, right, truth, **options):
    made = reconstructor(**options)
    cloud = made.reconstruct(left, right)
    volume = LAYOUT.volume()
    return made, cloud, point_errors(cloud.xyz, cloud.sigma_mm, truth, (volume.near_mm, volume.far_mm))


def test_equal_cameras_are_left_as_they_are() -> None:
    made, _, _ = _measured(*_pair("mixed"))
    np.testing.assert_array_equal(made.response[[0, 1, 2, 4]], 1)
    assert made.response[3] == pytest.approx(1, abs=0.02)
    assert made.warnings == ()


def test_the_white_balance_of_one_camera_displaces_nothing() -> None:
    _, _, equal = _measured(*_pair("mixed"))
    made, _, found = _measured(*_pair("mixed", lambda counts: counts * GAINS))
    np.testing.assert_allclose(made.response[:3], GAINS / GAINS.mean(), rtol=0.02)
    assert found.rms_mm < 1.1 * equal.rms_mm
    assert found.covered > equal.covered - 0.01
    assert found.error_to_sigma < 1.3
    unchanged = SETTINGS.with_overrides({"self_calibrate": False})
    _, _, wrong = _measured(*_pair("mixed", lambda counts: counts * GAINS), settings=unchanged)
    assert wrong.rms_mm > 2 * equal.rms_mm


@pytest.mark.parametrize("factor", [0.4, 0.6, 1.5])
def test_a_camera_of_another_brightness_costs_few_points(factor: float) -> None:
    _, _, equal = _measured(*_pair("mixed"))
    made, _, found = _measured(*_pair("mixed", lambda counts: np.float32(factor) * counts))
    assert made.response[4] == pytest.approx(factor, rel=0.05)
    np.testing.assert_array_equal(made.response[:3], 1)
    assert found.covered > equal.covered - 0.02
    assert found.wrong < equal.wrong + 0.001
    assert 0.8 < found.error_to_sigma < 1.3
    assert f"{made.response[4]:.2f} times as bright" in " ".join(made.warnings)


def test_a_blurred_camera_displaces_coloured_surfaces_less() -> None:
    def blurred(counts):
        return cv2.GaussianBlur(counts, (0, 0), 1.0)

    left, right, truth = _pair("mixed", blurred)
    made, _, found = _measured(left, right, truth)
    assert 0.7 < made.response[3] < 0.9
    _, _, without = _measured(left, right, truth, settings=SETTINGS.with_overrides({"self_calibrate": False}))
    assert found.rms_mm < 0.85 * without.rms_mm


def test_upright_and_level_fringes_show_the_same_contrast() -> None:
    left, right, _ = _pair("mixed", lambda counts: cv2.GaussianBlur(counts, (0, 0), 1.0))
    contrasts = []
    for axis in "xy":
        made = reconstructor(axis)
        made.reconstruct(
            *((image if axis == "x" else np.ascontiguousarray(image.swapaxes(0, 1))) for image in (left, right))
        )
        contrasts.append(made.response[3])
    assert contrasts[0] == pytest.approx(contrasts[1], rel=0.02)


def test_a_restored_state_gives_the_next_cloud_to_the_last_bit() -> None:
    left, right, _ = _pair("mixed", lambda counts: counts * GAINS)
    first, second = reconstructor(), reconstructor()
    first.reconstruct(left, right)
    second.restore(first.state())
    np.testing.assert_array_equal(second.reconstruct(left, right).xyz, first.reconstruct(left, right).xyz)


def test_an_empty_scene_calibrates_nothing_and_the_first_pair_with_points_does() -> None:
    left, right, _ = _pair("mixed", lambda counts: counts * GAINS)
    rng = np.random.default_rng(2)
    late, first = reconstructor(), reconstructor()
    for level in (0, 30):  # in the dark, and a grey wall with noise in place of fringes
        empty = [rng.poisson(level, left.shape).clip(0, 255).astype(np.uint8) for _ in range(2)]
        late.reconstruct(*empty)
        assert not late.calibrated
        np.testing.assert_array_equal(late.response, 1)
        np.testing.assert_array_equal(late.correction, 0)
    np.testing.assert_array_equal(late.reconstruct(left, right).xyz, first.reconstruct(left, right).xyz)
    assert late.calibrated
