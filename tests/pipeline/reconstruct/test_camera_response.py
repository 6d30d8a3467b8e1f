"""Unequal responses of the cameras, which the calibration does not know, are measured and corrected."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.decode.pixel_descriptor import over_the_image
from pipeline.reconstruct import camera_response, first_pair
from pipeline.reconstruct.camera_response import EQUAL, ERROR, TEXTURE, VIGNETTING
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.evaluate.point_errors import point_errors
from sim.render.render_pair import render_counts, truths, with_noise
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.pipeline.small import LAYOUT, PERIODS, SETTINGS, reconstructor
from tests.renders import render_pair, stored

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
    np.testing.assert_array_equal(made.response[ERROR], 0)
    np.testing.assert_array_equal(made.response[VIGNETTING], EQUAL[VIGNETTING])
    assert made.response[TEXTURE] == 1
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


@pytest.mark.parametrize("light", ["coloured lamp", "coloured ambient light"])
def test_a_colour_of_the_light_costs_few_points(light: str) -> None:
    """Both cameras see it: the phases are those of white light, and no camera is at fault."""
    color = np.array([1.25, 1.0, 0.75], np.float32)
    change = {
        "coloured lamp": lambda counts: color * counts,
        "coloured ambient light": lambda counts: counts + 60 * (color - 0.7),
    }
    _, _, equal = _measured(*_pair("mixed"))
    (left, right), truth = stored(_light, "mixed")
    images = with_noise((change[light](left), change[light](right)), Optics(), 3, "rgb8")
    made, _, found = _measured(*images, truth)
    assert found.covered > equal.covered - 0.01
    assert found.rms_mm < 1.15 * equal.rms_mm
    assert 0.75 < found.error_to_sigma < 1.3
    np.testing.assert_array_equal(made.response[:3], 1)
    assert made.warnings == ()


@pytest.mark.parametrize("factor", [0.35, 0.6, 1.5])
def test_a_camera_of_another_brightness_costs_few_points(factor: float) -> None:
    _, _, equal = _measured(*_pair("mixed"))
    made, _, found = _measured(*_pair("mixed", lambda counts: np.float32(factor) * counts))
    assert made.response[4] == pytest.approx(factor, rel=0.05)
    np.testing.assert_array_equal(made.response[:3], 1)
    assert found.covered > equal.covered - 0.02
    assert found.wrong < equal.wrong + 0.001
    assert 0.8 < found.error_to_sigma < 1.3
    assert f"{made.response[4]:.2f} times as bright" in " ".join(made.warnings)


@pytest.mark.parametrize("brightness", [1.0, pytest.param(0.6, marks=pytest.mark.long)])
def test_a_lens_that_darkens_the_corners_or_one_side_costs_few_points(brightness: float) -> None:
    _, _, equal = _measured(*_pair("mixed"))
    height, width = LAYOUT.camera_size[::-1]
    v, u = np.indices((height, width))
    terms = over_the_image(u.ravel(), v.ravel(), (width, height)).reshape(height, width, 7)
    for shape in ((1.0, 0, 0, -0.25, 0, -0.25, 0), (0.75, 0.25, 0, 0, 0, 0, 0)):
        light = (brightness * terms @ shape).astype(np.float32)[..., None]
        images = _pair("mixed", lambda counts, light=light: light * counts)
        made, cloud, found = _measured(*images)
        assert found.covered > equal.covered - 0.01
        assert found.wrong < equal.wrong + 0.001
        assert found.error_to_sigma == pytest.approx(equal.error_to_sigma, rel=0.1)
        assert "varies by" in " ".join(made.warnings)
        # In the middle, where most of the points are: what the lens took is given back.
        there = np.s_[height // 5 : -height // 5, width // 5 : -width // 5]
        even = (terms @ made.response[VIGNETTING] / made.response[4])[there] * light[there][..., 0]
        assert even.max() / even.min() < 1.06
        without = reconstructor()
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(camera_response, "vignetting_of_points", lambda *_, **__: EQUAL[VIGNETTING])
            without.reconstruct(*images[:2])
        other = reconstructor()
        other.restore(made.state())
        np.testing.assert_array_equal(other.reconstruct(*images[:2]).xyz, made.reconstruct(*images[:2]).xyz)
        assert cloud.points > without.reconstruct(*images[:2]).points


def test_where_fringes_repeat_lenses_make_few_points_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both lenses darken their corners by half: a surface point is nearer to the corner in one image."""
    middle = replace(LAYOUT, projector_fraction=0.5)
    pattern, optics, scene, volume = middle.pattern(PERIODS), Optics(), build("mixed"), middle.volume()
    v, u = np.indices(middle.camera_size[::-1])
    shape = over_the_image(u.ravel(), v.ravel(), middle.camera_size) @ (1.0, 0, 0, -0.25, 0, -0.25, 0)
    counts = [
        shape.reshape((*u.shape, 1)).astype(np.float32) * one for one in render_counts(middle, scene, pattern, optics)
    ]
    images = with_noise((counts[0], counts[1]), optics, 3, "rgb8")
    truth = truths(middle, scene, pattern)[0]

    def measured():
        made = Reconstructor(middle.calibration_for(optics), pattern, volume, settings=SETTINGS)
        cloud = made.reconstruct(*images)
        return made, point_errors(cloud.xyz, cloud.sigma_mm, truth, (volume.near_mm, volume.far_mm))

    made, found = measured()
    assert made.repeats and (made.response[VIGNETTING] != EQUAL[VIGNETTING]).any()
    monkeypatch.setattr(camera_response, "vignetting_of_points", lambda *_, **__: EQUAL[VIGNETTING])
    _, without = measured()
    assert found.covered > without.covered + 0.02
    assert found.wrong < 0.4 * without.wrong


@pytest.mark.parametrize("deviation", [0.25, pytest.param(0.15, marks=pytest.mark.long)])
def test_surfaces_that_reflect_otherwise_to_both_cameras_cost_few_points(deviation: float) -> None:
    """A field of factors that are alike over some tens of pixels, as of surfaces that shine."""
    noise = np.random.default_rng(31).standard_normal(LAYOUT.camera_size[::-1]).astype(np.float32)
    field = cv2.GaussianBlur(noise, (0, 0), 30)
    factors = np.exp(deviation * field / field.std())[..., None]
    _, _, equal = _measured(*_pair("mixed"))
    left, right, truth = _pair("mixed", lambda counts: factors * counts)
    made, cloud, found = _measured(left, right, truth)
    assert (
        0.7 < made.response[TEXTURE] * deviation / camera_response.TEXTURES_ALIKE < 1.6
    )  # the correction takes a part
    assert found.covered > equal.covered - 0.03
    assert found.wrong < equal.wrong + 0.001
    assert 0.7 < found.error_to_sigma < 1.3
    without, hidden = reconstructor(), reconstructor()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(camera_response, "texture_share", lambda *_: 1.0)
        assert without.reconstruct(left, right).points < cloud.points
        # With all of the texture's weight hardly any pixels would agree with the projector's offset up to noise.
        patch.setattr(first_pair, "_LOW_GAIN", 0.0)
        hidden.reconstruct(left, right)
    assert made.gain > max(0.3, 2 * hidden.gain)
    other = reconstructor()
    other.restore(made.state())
    np.testing.assert_array_equal(other.reconstruct(left, right).xyz, made.reconstruct(left, right).xyz)


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


def _faulty(scene, encoding, **faults):
    pattern = LAYOUT.pattern(PERIODS)
    return render_pair(LAYOUT, build(scene), pattern, Optics(**faults), 0.0, 5, encoding)


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_the_periodic_error_of_displaced_colours_is_measured_and_the_projector_agrees_better(encoding: str) -> None:
    """Red and blue displaced by 0.3 columns to either side: their angles are wrong by 0.3 of a column's phase."""
    pair = _faulty("mixed", encoding, color_shift_px=(0.3, 0.0, -0.3))
    made = reconstructor(encoding=encoding)
    made.reconstruct(pair.left, pair.right)
    slope = (made.pattern.phase[-1] - made.pattern.phase[0]) / (made.pattern.length - 1)
    # The three-step solution's part that runs backwards: a third of the channels' angles, each turned by its shift.
    turned = np.exp(2j * np.array(made.pattern.shifts)) @ np.array([0.3, 0.0, -0.3]) * slope / 3
    found = np.hypot(*made.response[ERROR][2:4])
    assert found == pytest.approx(abs(turned), rel=0.15)
    assert np.abs(np.delete(made.response[ERROR], [2, 3])).max() < 0.015
    without = reconstructor(encoding=encoding)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(camera_response, "periodic_error", lambda *_: np.zeros(6))
        without.reconstruct(pair.left, pair.right)
    assert made.gain > 1.3 * without.gain


def test_an_unknown_response_of_the_projector_is_reported_with_its_size() -> None:
    pair = _faulty("mixed", "rgb8", gamma=2.2, precorrected=False)
    made = reconstructor()
    made.reconstruct(pair.left, pair.right)
    error = made.response[ERROR]
    assert np.hypot(*error[4:]) > 0.1 > 3 * np.hypot(*error[2:4])
    assert f"a periodic error of {camera_response.rms_of(error):.2f} rad" in " ".join(made.warnings)
    # All of it is in the state, which travels to other processes.
    other = reconstructor()
    other.restore(made.state())
    np.testing.assert_array_equal(
        other.reconstruct(pair.left, pair.right).xyz, made.reconstruct(pair.left, pair.right).xyz
    )


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
        np.testing.assert_array_equal(late.response, EQUAL)
        np.testing.assert_array_equal(late.correction, 0)
    np.testing.assert_array_equal(late.reconstruct(left, right).xyz, first.reconstruct(left, right).xyz)
    assert late.calibrated
