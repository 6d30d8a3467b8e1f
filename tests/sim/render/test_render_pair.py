"""Light and sensor obey their models, and seeds reproduce."""

from __future__ import annotations

import numpy as np
import pytest

from sim.render import render_pair, sensor
from sim.rig.layout import RigLayout
from sim.rig.optics import WHITE_ALBEDO, Optics
from sim.scene import named_scenes
from sim.scene.scene import Scene
from sim.scene.shapes import Motion, plane, rectangle


@pytest.fixture(scope="module")
def board():
    return named_scenes.build("plane")


def test_a_seed_reproduces_every_bit_and_another_seed_does_not(small):
    scene = named_scenes.build("mixed", seed=3)
    first, again, other = (render_pair.render_pair(small, scene, small.pattern(), seed=s) for s in (5, 5, 6))
    assert np.array_equal(first.left, again.left)
    assert np.array_equal(first.right, again.right)
    assert np.array_equal(first.truth_left.xyz, again.truth_left.xyz, equal_nan=True)
    assert not np.array_equal(first.left, other.left)
    assert not np.array_equal(first.left, first.right)


def test_images_do_not_depend_on_the_number_of_threads(small, monkeypatch):
    scene = named_scenes.build("mixed")
    several = render_pair.render_counts(small, scene, small.pattern(), Optics())
    monkeypatch.setattr(render_pair.os, "cpu_count", lambda: 1)
    one = render_pair.render_counts(small, scene, small.pattern(), Optics())
    assert np.array_equal(several[0], one[0])


def test_scene_seeds_change_the_texture_only(small):
    a, b = (named_scenes.build("mixed", seed=s) for s in (0, 1))
    xyz = [render_pair.truths(small, scene)[0].xyz for scene in (a, b)]
    assert np.array_equal(*xyz, equal_nan=True)
    counts = [render_pair.render_counts(small, scene, small.pattern(), Optics())[0] for scene in (a, b)]
    assert np.abs(counts[0] - counts[1]).mean() > 3


def test_a_white_board_peaks_at_the_white_level(small, board):
    optics = Optics(noise=0.0)
    counts = render_pair.render_counts(small, board, small.pattern(), optics)
    for image in counts:
        assert 0.85 * optics.white_dn < image.max() + optics.black_dn < 1.05 * optics.white_dn


def test_light_falls_with_the_square_of_the_distance_and_the_cosine(small):
    white = np.full((128, 160, 3), 255, np.uint8)
    optics = Optics.ideal(gamma=1.0)
    scene = Scene("board", (rectangle(300, 250).placed((5, 3, 40), turn=(0.2, 0.4, 0), albedo=WHITE_ALBEDO),))
    counts = render_pair.render_counts(small, scene, white, optics)[0]
    truth, _ = render_pair.truths(small, scene)
    rig, (rotation, origin) = small.calibration(), small.stage_pose()
    normal = -(rotation @ scene.shapes[0].pose(0)[0])[:, 2]
    ray = rig.projector.centre - truth.xyz.astype(np.float64)
    distance = np.linalg.norm(ray, axis=-1)
    standoff = np.linalg.norm(rig.projector.centre - origin)
    expected = optics.gain(0) * WHITE_ALBEDO * 255 * (ray @ normal) / distance * (standoff / distance) ** 2
    inner = np.s_[25:75, 35:90]
    assert truth.lit[inner].all()
    assert np.abs(counts[inner][..., 1] / expected[inner] - 1).max() < 2e-3


def test_noise_variance_follows_photon_and_read_noise(small, board):
    optics = Optics(read_noise_dn=1.5, full_well_e=5000)
    flat = np.full((128, 160, 3), 90, np.uint8)
    counts = render_pair.render_counts(small, board, flat, optics)
    stack = np.stack([render_pair.with_noise(counts, optics, seed, "rgb8")[0] for seed in range(60)]).astype(np.float64)
    measured = stack.var(axis=0, ddof=1).mean()
    expected = (counts[0] * 255 / 5000 + 1.5**2 + 1 / 12).mean()
    assert measured == pytest.approx(expected, rel=0.02)
    assert stack.mean() == pytest.approx(counts[0].mean() + optics.black_dn, abs=0.02)


def test_noise_of_left_and_right_is_independent(small, board):
    optics = Optics()
    counts = render_pair.render_counts(small, board, small.pattern(), optics)
    left, right = render_pair.with_noise((counts[0], counts[0]), optics, 1, "rgb8")
    clean = counts[0] + optics.black_dn
    assert abs(np.corrcoef((left - clean).ravel(), (right - clean).ravel())[0, 1]) < 0.02


@pytest.mark.parametrize("encoding", list(sensor.MOSAICS))
def test_a_bayer_image_is_the_colour_image_sub_sampled(encoding, small):
    scene, optics = named_scenes.build("mixed"), Optics()
    color = render_pair.render_counts(small, scene, small.pattern(), optics)[0]
    bayer = render_pair.render_counts(small, scene, small.pattern(), optics, encoding=encoding)[0]
    letters = encoding.removeprefix("bayer_").removesuffix("8")
    for cell, letter in enumerate(letters):
        row, column = divmod(cell, 2)
        assert np.array_equal(bayer[row::2, column::2], color[row::2, column::2, "rgb".index(letter)])


def test_mono16_has_the_same_light_at_full_scale_65535(small, board):
    optics = Optics(noise=0.0)
    low = render_pair.render_pair(small, board, small.pattern(), optics, encoding="mono8").left
    high = render_pair.render_pair(small, board, small.pattern(), optics, encoding="mono16").left
    assert high.dtype == np.uint16
    assert np.abs(high / 257 - low).max() <= 0.51


def test_crosstalk_mixes_projector_channels_as_calibrated(small, board):
    optics = Optics(noise=0.0, ambient=0.0)
    calibration = small.calibration_for(optics)
    for channel in range(3):
        image = np.zeros((128, 160, 3), np.uint8)
        image[..., channel] = 200
        counts = render_pair.render_counts(small, board, image, optics)
        for seen, color in zip(counts, (calibration.left_color, calibration.right_color), strict=True):
            answer = seen[40:60, 50:80].mean(axis=(0, 1))
            assert answer / answer[channel] == pytest.approx(color.crosstalk[:, channel], abs=1e-4)


def test_a_pre_corrected_pattern_gives_the_light_of_a_linear_projector(small, board):
    pattern = small.pattern()
    linear = render_pair.render_counts(small, board, pattern, Optics())[0]
    corrected = render_pair.render_counts(small, board, pattern, Optics(gamma=2.2))[0]
    bare = render_pair.render_counts(small, board, pattern, Optics(gamma=2.2, precorrected=False))[0]
    assert np.abs(corrected - linear).max() < 1.5
    assert np.abs(bare - linear).max() > 20


def test_the_calibration_has_the_errors_of_realistic_optics(small):
    optics = Optics.realistic()
    true, known = small.calibration(), small.calibration_for(optics)
    assert known.response is not None
    assert np.allclose(known.response.light(np.array([[255.0, 128, 0]])), 255 * (np.array([1, 128 / 255, 0])) ** 2.2)
    off = (known.left_color.crosstalk / optics.true_crosstalk()[0])[~np.eye(3, dtype=bool)]
    assert np.abs(off - 1).max() == pytest.approx(0.10)
    point = np.array([[0.0, 0.0, small.standoff_mm], [150.0, 50.0, small.standoff_mm]])
    error = known.projector.project(point) - true.projector.project(point)
    assert 0.2 <= np.abs(error[:, 0]).min() <= np.abs(error[:, 0]).max() <= 0.41
    assert small.calibration_for(Optics()).projector.matrix == pytest.approx(true.projector.matrix)


def _phase(image):
    red, green, blue = (image[..., c].astype(np.float64) for c in range(3))
    return np.arctan2(np.sqrt(3) * (red - blue), 2 * green - red - blue)


def test_defocus_lowers_the_modulation_as_a_gaussian_does(board):
    layout = RigLayout().scaled(0.125)
    pattern = layout.pattern()
    sharp, soft = (
        render_pair.render_counts(layout, board, pattern, Optics.ideal(defocus_px=d, supersampling=4))[0][
            30:70, 30:90, 1
        ]
        for d in (0.5, 1.5)
    )
    omega = 2 * np.pi * pattern.periods / pattern.length
    ratio = np.ptp(soft) / np.ptp(sharp)
    assert ratio == pytest.approx(np.exp(-(omega**2) * (1.5**2 - 0.5**2) / 2), abs=0.02)


def test_color_shift_moves_one_channel_by_projector_pixels(small, board):
    pattern = small.pattern()
    counts = [
        render_pair.render_counts(small, board, pattern, Optics.ideal(color_shift_px=(0.0, shift, 0.0)))[0][..., 1]
        for shift in (0.0, pattern.length / pattern.periods)
    ]
    # A whole period to the right is where it was.
    assert np.abs(counts[0] - counts[1])[30:70, 30:90].max() < 0.5


def test_chromatic_aberration_leaves_green_and_moves_red_and_blue_apart(small):
    scene = named_scenes.build("spheres")
    plain = render_pair.render_counts(small, scene, small.pattern(), Optics.ideal())[0]
    spoiled = render_pair.render_counts(small, scene, small.pattern(), Optics.ideal(chromatic=5e-3))[0]
    assert np.array_equal(plain[..., 1], spoiled[..., 1])
    assert np.abs(plain - spoiled)[..., [0, 2]].max() > 5
    middle = np.s_[48:54, 61:67]
    assert np.abs(plain - spoiled)[middle].max() < 4


def test_over_exposure_saturates_at_255(small, board):
    pair = render_pair.render_pair(small, board, small.pattern(), Optics(exposure=2.5))
    assert pair.left.max() == 255
    assert (pair.left == 255).mean() > 0.05


def _exposure_error(layout, supersampling):
    """One long exposure minus the mean of sixteen short ones, and what the motion itself changes."""
    shape = rectangle(140, 140).placed((0, 0, 0), motion=Motion(swing_mm=(25, 0, 10)))
    scene = Scene("one", (shape,), period_s=1.0)

    def exposed(t_s, exposure_us):
        optics = Optics.ideal(exposure_us=exposure_us, supersampling=supersampling)
        return render_pair.render_counts(layout, scene, layout.pattern(), optics, t_s)[0]

    parts = [exposed(i * 5e-3, 5e3) for i in range(16)]
    long = exposed(0.0, 8e4)
    return np.abs(long - np.mean(parts, axis=0)), np.abs(long - parts[0])


def test_an_exposure_is_the_mean_over_its_instants(small):
    inner = np.s_[34:68, 50:75]
    error, motion = _exposure_error(small, 2)
    coarser, _ = _exposure_error(small, 1)
    assert motion[inner].mean() > 1
    assert error[inner].mean() < 0.01 * motion[inner].mean()
    # A moving edge is only as smooth as the rays of a pixel are many.
    assert error.mean() < 0.6 * coarser.mean()


def test_a_motion_of_nothing_is_rest(small):
    at_rest = Scene("a", (plane().placed(),))
    nominal = Scene("b", (plane().placed(motion=Motion()),))
    a, b = (render_pair.render_counts(small, scene, small.pattern(), Optics())[0] for scene in (at_rest, nominal))
    assert np.abs(a - b).max() < 1e-3


def test_motion_closes_its_loop():
    scene = named_scenes.build("moving")
    for shape in scene.shapes:
        for a, b in zip(shape.pose(scene.share(0.0)), shape.pose(scene.share(scene.period_s)), strict=True):
            assert np.abs(a - b).max() < 1e-9


def test_ambient_light_is_seen_in_the_shadow(small):
    scene = named_scenes.build("spheres")
    truth, _ = render_pair.truths(small, scene)
    counts = render_pair.render_counts(small, scene, small.pattern(), Optics.ideal(ambient=0.1, supersampling=1))[0]
    shadow = truth.hit & ~truth.lit
    assert shadow.sum() > 50
    assert counts[shadow].min() > 5
    assert np.ptp(counts[shadow], axis=-1).max() < 1e-3


def test_an_image_of_the_wrong_size_is_refused(small, board):
    with pytest.raises(ValueError, match=r"the projector takes \(128, 160, 3\)"):
        render_pair.render_pair(small, board, np.zeros((10, 10, 3), np.uint8))


def test_unknown_scenes_and_encodings_are_named(small, board):
    with pytest.raises(ValueError, match=r"'moon' is not known.*mixed"):
        named_scenes.build("moon")
    with pytest.raises(ValueError, match=r"'rgb16' is not known.*bayer_rggb8"):
        render_pair.render_pair(small, board, small.pattern(), encoding="rgb16")


def test_all_axes_meet_on_the_stage():
    layout = RigLayout(lens=0.0)
    rig = layout.calibration()
    assert rig.baseline_mm == pytest.approx(layout.baseline_mm)
    for device in (rig.left, rig.right, rig.projector):
        principal = device.matrix[:2, 2]
        assert device.project(np.array([0.0, 0.0, layout.standoff_mm])) == pytest.approx(principal, abs=1e-6)


def test_the_projector_has_the_position_of_the_layout():
    layout = RigLayout(projector_fraction=0.25, projector_up_mm=80)
    rig = layout.calibration()
    along = (rig.right.centre - rig.left.centre) / rig.baseline_mm
    assert (rig.projector.centre - rig.left.centre) @ along == pytest.approx(0.25 * layout.baseline_mm)
    assert rig.projector.centre[1] == pytest.approx(-80)


def test_a_scaled_rig_keeps_its_field_and_its_fringes_on_the_wall():
    layout = RigLayout()
    small = layout.scaled(0.25)
    a, b = (lay.calibration().projector.project(np.array([100.0, 50.0, 1420.0])) for lay in (layout, small))
    assert (a + 0.5) / 4 - 0.5 == pytest.approx(b, abs=0.01)
    assert small.periods == 24


def test_phase_of_both_cameras_agrees_at_a_point_of_the_board(small, board):
    pair = render_pair.render_counts(small, board, small.pattern(), Optics.ideal(supersampling=4))
    truth, _ = render_pair.truths(small, board)
    right = small.calibration().right.project(truth.xyz[50, 40:80].astype(np.float64))
    wave = np.exp(1j * _phase(pair[1]))
    u, v = right.T
    i, j = np.floor(v).astype(int), np.floor(u).astype(int)
    fu, fv = u - j, v - i
    there = (1 - fv) * ((1 - fu) * wave[i, j] + fu * wave[i, j + 1]) + fv * (
        (1 - fu) * wave[i + 1, j] + fu * wave[i + 1, j + 1]
    )
    difference = np.angle(np.exp(1j * _phase(pair[0])[50, 40:80]) / there)
    assert np.abs(difference).max() < 0.05
