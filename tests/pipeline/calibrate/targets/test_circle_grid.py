"""Circles of simulated images: their positions, sigmas, and independence of light, type and surroundings."""

import cv2
import numpy as np
import pytest

from pipeline.calibrate.targets.board.board import DEFAULT_BOARD, parse_board
from pipeline.calibrate.targets.detect.grid_numbering import symmetries
from pipeline.calibrate.targets.find_marks import find_marks

from .images import Pose, camera, centres, clean, noisy, truth

DEVICE = camera()
TILTED = Pose(25, -35, 8)


@pytest.fixture(scope="module")
def tilted():
    return clean(DEFAULT_BOARD, DEVICE, TILTED)


def errors(found, board, device, pose, positions=truth):
    """Detected minus true positions (n, 2), in the symmetric numbering of the image."""
    expected = positions(board, device, pose)
    trials = [found.marks.pixels - expected[np.array(s)][found.marks.ids] for s in symmetries(board)]
    return min(trials, key=lambda error: np.abs(error).max())


FAR = (0.0, 0.0, 1800.0)
POSES = [
    pytest.param(Pose(), marks=pytest.mark.long),
    pytest.param(Pose(45), marks=pytest.mark.long),
    pytest.param(Pose(0, 45), marks=pytest.mark.long),
    Pose(-30, 30, 35, FAR),
    Pose(60, 0, 10),
    pytest.param(Pose(20, 10, 90, FAR), marks=pytest.mark.long),
    pytest.param(Pose(-15, 20, 180), marks=pytest.mark.long),
]


@pytest.mark.parametrize("pose", POSES)
def test_every_circle_is_located_where_the_full_model_has_its_centroid(pose):
    light = clean(DEFAULT_BOARD, DEVICE, pose, shade=(0.5, -0.3))
    error, sigma = [], []
    for seed in range(3):
        found = find_marks(noisy(light, seed), DEFAULT_BOARD)
        assert sorted(found.marks.ids) == list(range(99))
        error.append(errors(found, DEFAULT_BOARD, DEVICE, pose))
        sigma.append(found.marks.sigma_px)
    error, sigma = np.array(error), np.array(sigma)
    assert np.sqrt((error**2).mean()) < 0.008
    assert np.sqrt((error**2).mean()) < 1.2 * np.sqrt((sigma**2).mean())
    assert np.sqrt((error**2).mean()) > 0.8 * np.sqrt((sigma**2).mean())
    assert np.abs(error.mean(axis=(0, 1))).max() < 0.001


@pytest.mark.parametrize("noise", [1.0, pytest.param(3.0, marks=pytest.mark.long), 8.0])
def test_the_standard_deviation_follows_the_noise(tilted, noise):
    error, sigma = [], []
    for seed in range(6):
        image = noisy(tilted, seed, full_well=10_000 / noise**2, read_dn=0.8 * noise)
        found = find_marks(image, DEFAULT_BOARD)
        assert len(found.marks) == 99
        error.append(errors(found, DEFAULT_BOARD, DEVICE, TILTED))
        sigma.append(found.marks.sigma_px)
    ratio = np.sqrt(np.mean(np.square(error)) / np.mean(np.square(sigma)))
    assert 1 / 1.2 < ratio < 1.2
    assert np.mean(sigma) == pytest.approx(0.0034 * noise, rel=0.25)


def test_the_bias_of_the_circles_centres_is_what_the_centroid_corrects():
    """At 45 degrees the centre of a circle is 0.04 px away from the centroid of its image, in one direction."""
    pose = Pose(0, 45)
    found = find_marks(noisy(clean(DEFAULT_BOARD, DEVICE, pose)), DEFAULT_BOARD)
    without = errors(found, DEFAULT_BOARD, DEVICE, pose, centres).mean(axis=0)
    corrected = errors(found, DEFAULT_BOARD, DEVICE, pose).mean(axis=0)
    assert np.linalg.norm(without) > 0.03
    assert np.linalg.norm(corrected) < 0.002


def test_areas_give_the_diameter(tilted):
    from pipeline.calibrate.targets.localise import circle_projection

    marks = find_marks(noisy(tilted), parse_board("circles:11x9:32")).marks
    rotation, translation = TILTED.of(DEFAULT_BOARD)
    ids = marks.ids if errors_without_turn(marks) else 98 - marks.ids
    diameter = circle_projection.diameter_mm(marks.areas_px, DEVICE, rotation, translation, DEFAULT_BOARD.points[ids])
    assert diameter == pytest.approx(20, abs=0.02)


def errors_without_turn(marks):
    return np.abs(marks.pixels - truth(DEFAULT_BOARD, DEVICE, TILTED)[marks.ids]).max() < 1


@pytest.mark.parametrize("shade", [(1.7, 0.0), (-1.2, 0.7)])
def test_a_gradient_of_light_does_not_move_the_circles(shade):
    found = find_marks(noisy(clean(DEFAULT_BOARD, DEVICE, TILTED, shade=shade, light=110)), DEFAULT_BOARD)
    error = errors(found, DEFAULT_BOARD, DEVICE, TILTED)
    assert len(error) == 99
    assert np.abs(error.mean(axis=0)).max() < 0.002


@pytest.mark.parametrize("blur_px", [0.35, *(pytest.param(blur, marks=pytest.mark.long) for blur in (1.5, 3.0)), 4.0])
def test_blur_increases_the_sigma_but_gives_no_bias(blur_px):
    found = find_marks(noisy(clean(DEFAULT_BOARD, DEVICE, Pose(20, 20), blur_px=blur_px)), DEFAULT_BOARD)
    error = errors(found, DEFAULT_BOARD, DEVICE, Pose(20, 20))
    assert len(error) == 99
    assert np.sqrt((error**2).mean()) < 1.3 * np.sqrt((found.marks.sigma_px**2).mean())
    assert np.abs(error.mean(axis=0)).max() < (0.002 if blur_px < 4 else 0.01)
    assert found.sharpness_px == pytest.approx(np.hypot(blur_px, np.sqrt(1 / 12)), rel=0.1)


@pytest.mark.parametrize("shadow", [0.5, pytest.param(0.35, marks=pytest.mark.long), 0.2])
def test_a_sharp_shadow_over_a_part_of_the_board(tilted, shadow):
    """Circles that the edge of the shadow crosses are left out: their light is not even."""
    v, u = np.mgrid[0:410, 0:512]
    found = find_marks(noisy(np.where(u + 0.7 * v < 370, shadow, 1.0) * tilted), DEFAULT_BOARD)
    error = np.linalg.norm(errors(found, DEFAULT_BOARD, DEVICE, TILTED), axis=1)
    assert len(error) >= 80
    assert np.median(error) < 0.01 and error.max() < 0.1


def test_moving_the_image_by_whole_pixels_moves_the_marks_by_as_much(tilted):
    image = noisy(tilted)
    marks = find_marks(image, DEFAULT_BOARD).marks
    for right, down in ((1, 0), (0, 1), (7, 5)):
        moved = find_marks(np.pad(image, ((down, 0), (right, 0)), mode="edge"), DEFAULT_BOARD).marks
        assert (moved.ids == marks.ids).all()
        assert np.abs(moved.pixels - marks.pixels - (right, down)).max() < 0.003


@pytest.mark.parametrize(("gain", "offset"), [(0.4, 20.0), (3.0, -30.0), (1e-3, 0.0)])
def test_gain_and_offset_of_the_image_change_nothing(tilted, gain, offset):
    image = noisy(tilted).astype(np.float32)
    marks = find_marks(image, DEFAULT_BOARD).marks
    other = find_marks(image * np.float32(gain) + np.float32(offset), DEFAULT_BOARD).marks
    assert (other.ids == marks.ids).all()
    assert np.abs(other.pixels - marks.pixels).max() < 0.003
    assert other.sigma_px == pytest.approx(marks.sigma_px, rel=0.25)


def test_light_circles_on_a_dark_ground(tilted):
    marks = find_marks(noisy(tilted), DEFAULT_BOARD).marks
    inverse = find_marks(255 - noisy(tilted), DEFAULT_BOARD).marks
    assert (inverse.ids == marks.ids).all()
    assert np.abs(inverse.pixels - marks.pixels).max() < 0.005


def test_other_types_and_colour_give_the_same_marks(tilted):
    image = noisy(tilted)
    marks = find_marks(image, DEFAULT_BOARD).marks
    color = np.stack([image] * 3, axis=2)
    for other in (image.astype(np.uint16) * 256, image.astype(np.float32) / 255, color):
        assert np.abs(find_marks(other, DEFAULT_BOARD).marks.pixels - marks.pixels).max() < 0.003
    saturated = color.copy()
    saturated[..., 0] = np.clip(3.0 * image, 0, 255).astype(np.uint8)
    found = find_marks(saturated, DEFAULT_BOARD)
    assert np.abs(found.marks.pixels - marks.pixels).max() < 0.003
    assert 0.05 < found.saturated < 0.34
    assert np.abs(find_marks(color, DEFAULT_BOARD, channel=2).marks.pixels - marks.pixels).max() < 1e-6


def test_a_saturated_ground_gives_no_bias(tilted):
    found = find_marks(noisy(tilted, gain=2.0), DEFAULT_BOARD)
    error = errors(found, DEFAULT_BOARD, DEVICE, TILTED)
    assert found.saturated > 0.3
    assert len(error) == 99
    assert np.abs(error.mean(axis=0)).max() < 0.005
    assert np.sqrt((error**2).mean()) < 0.012


def test_correlated_noise_of_demosaicing_is_counted(tilted):
    rng = np.random.default_rng(3)
    error, sigma = [], []
    for _ in range(4):
        white = rng.standard_normal(tilted.shape)
        smeared = sum(np.roll(white, shift, (0, 1)) for shift in ((0, 0), (0, 1), (1, 0), (1, 1))) / 2
        found = find_marks((tilted + 3.0 * smeared).astype(np.float32), DEFAULT_BOARD)
        error.append(errors(found, DEFAULT_BOARD, DEVICE, TILTED))
        sigma.append(found.marks.sigma_px)
    assert np.sqrt(np.mean(np.square(error)) / np.mean(np.square(sigma))) == pytest.approx(1, abs=0.25)


@pytest.mark.parametrize(
    "text",
    [
        "circles:11x9:32:20",
        pytest.param("acircles:7x13:36:14", marks=pytest.mark.long),
        pytest.param("circles:8x8:32:20", marks=pytest.mark.long),
        "acircles:6x12:36:14",
    ],
)
def test_no_turn_of_the_board_mirrors_its_numbers_and_rows_run_right_or_down(text):
    board = parse_board(text)
    for turn in range(0, 360, 30):
        pose = Pose(15, 10, turn, FAR)
        found = find_marks(noisy(clean(board, DEVICE, pose, ss=2)), board, refine=False)
        assert len(found.marks) == len(board.points)
        assert np.abs(errors(found, board, DEVICE, pose)).max() < 0.3
        basis = np.column_stack([board.points[found.marks.ids, :2], np.ones(len(found.marks))])
        right, down = np.linalg.lstsq(basis, found.marks.pixels, rcond=None)[0][:2]
        assert right[0] * down[1] - right[1] * down[0] > 0
        if len(symmetries(board)) == 2:
            assert right.sum() > 0
        elif len(symmetries(board)) == 4:
            assert right[0] > abs(right[1]) * 0.99


def test_two_cameras_number_the_board_alike():
    for turn in (0, 85, 95, 170):
        pixels = []
        for y_deg, x_mm in ((20, -150), (0, 150)):
            pose = Pose(10, y_deg, turn, (x_mm * 0.1, 0, 1800))
            found = find_marks(noisy(clean(DEFAULT_BOARD, DEVICE, pose, ss=2)), DEFAULT_BOARD, refine=False)
            pixels.append(found.marks.pixels[np.argsort(found.marks.ids)])
        moved = pixels[0] - pixels[0].mean(axis=0) - pixels[1] + pixels[1].mean(axis=0)
        assert np.abs(moved).max() < 40


def test_covered_circles_are_left_out_and_the_others_keep_their_numbers(tilted):
    image = noisy(tilted)
    expected = find_marks(image, DEFAULT_BOARD).marks
    for mark in (0, 16, 50, 51):
        u, v = np.round(expected.pixels[expected.ids == mark][0]).astype(int)
        image[v - 9 : v + 10, u : u + 12] = 120
    found = find_marks(image, DEFAULT_BOARD).marks
    assert 93 <= len(found) <= 95
    assert not set(found.ids) & {0, 16, 50, 51}
    same = expected.pixels[np.searchsorted(expected.ids, found.ids)]
    assert np.median(np.abs(found.pixels - same)) < 0.002 and np.abs(found.pixels - same).max() < 0.02


def test_unrefined_detection_is_fast_and_good_to_a_tenth_of_a_pixel(tilted):
    image = noisy(tilted)
    quick, best = find_marks(image, DEFAULT_BOARD, refine=False), find_marks(image, DEFAULT_BOARD)
    assert (quick.marks.ids == best.marks.ids).all()
    assert np.abs(quick.marks.pixels - best.marks.pixels).max() < 0.1
    assert quick.sharpness_px == pytest.approx(best.sharpness_px, rel=0.1)
    assert quick.contrast == pytest.approx(best.contrast, abs=0.05)
    assert best.contrast > 0.9


@pytest.mark.parametrize(("width", "height", "focal"), [(256, 204, 850.0), (333, 301, 1100.0)])
def test_small_images_and_odd_sizes(width, height, focal):
    device = camera(width, height, focal)
    for pose in (Pose(), Pose(30, 30, 0, (0, 0, 1500))):
        found = find_marks(noisy(clean(DEFAULT_BOARD, device, pose)), DEFAULT_BOARD)
        error = errors(found, DEFAULT_BOARD, device, pose)
        assert len(error) == 99 and np.sqrt((error**2).mean()) < 0.015


@pytest.mark.long
def test_five_megapixels():
    device = camera(2592, 1944, 8600.0)
    found = find_marks(noisy(clean(DEFAULT_BOARD, device, TILTED, ss=1, blur_px=1.2)), DEFAULT_BOARD)
    assert len(found.marks) == 99
    assert np.abs(errors(found, DEFAULT_BOARD, device, TILTED)).max() < 0.05


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.long) for seed in (2, 3))])
def test_discs_and_boxes_around_the_board_do_not_confuse(seed):
    rng = np.random.default_rng(seed)
    clutter = np.full((410, 512), 60, np.float32)
    for _ in range(80):
        (u, v), tone = rng.integers(0, (512, 410)).tolist(), float(rng.uniform(5, 200))
        if rng.random() < 0.6:
            cv2.circle(clutter, (u, v), int(rng.integers(4, 30)), tone, -1)
        else:
            cv2.rectangle(clutter, (u, v), (u + int(rng.integers(5, 120)), v + int(rng.integers(5, 120))), tone, -1)
    pose = Pose(*rng.uniform(-40, 40, 2), rng.uniform(-180, 180), (30, -20, 2100))
    lit = clean(DEFAULT_BOARD, DEVICE, pose, background=0.0, ss=3)
    beside = (clean(DEFAULT_BOARD, DEVICE, pose, background=0.9, ss=3) - lit) / 200
    found = find_marks(noisy(lit + beside * cv2.GaussianBlur(clutter, (0, 0), 0.8), seed), DEFAULT_BOARD)
    error = errors(found, DEFAULT_BOARD, DEVICE, pose)
    assert len(error) == 99
    assert np.sqrt((error**2).mean()) < 1.3 * np.sqrt((found.marks.sigma_px**2).mean())
