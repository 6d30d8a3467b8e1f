"""Colour calibration of a board with known colours."""

import functools

import numpy as np
import pytest

from pipeline.calibrate.color import calibrate_color, check_sequence, color_sequence, phase_error
from pipeline.calibrate.color.crosstalk import black_from_marks
from pipeline.common.errors import ImageError, PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.rig.calibration import Calibration, from_mapping, to_mapping
from pipeline.rig.lateral_chromatic import ColorDisplacement, ColorOffset, LateralChromatic, Registration
from tests.pipeline.calibrate.color.white_board import CAMERA, MIX, PROJECTOR, WhiteBoard, projected, rig

PATTERN = ColorFringe(PROJECTOR, 20)
LATERAL_CHROMATIC = LateralChromatic(
    ColorDisplacement(np.array([0.05, -0.02]), -1.2e-3, 0.01), ColorDisplacement(np.array([-0.03, 0.03]), 1.5e-3, 0.0)
)
REGISTRATION = Registration(
    ColorOffset(np.array([0.3, 0.1])), ColorOffset(np.array([-0.4, 0.0]), np.array([[5e-4, 0], [0, 5e-4]]))
)


@functools.cache
def solved(*, lateral_frames=True, **options):
    board = WhiteBoard(**options)
    sequence = color_sequence(PROJECTOR, lateral_chromatic=lateral_frames)
    return board, calibrate_color(board.capture(sequence), sequence, encoding=board.encoding, calibration=rig())


@pytest.mark.parametrize("encoding", ["rgb8", pytest.param("bayer_grbg8", marks=pytest.mark.long)])
def test_crosstalk_and_response_are_estimated(encoding):
    board, found = solved(encoding=encoding)
    for side, model in enumerate((found.left, found.right)):
        assert np.abs(model.crosstalk - MIX[side]).max() < 0.002
    assert np.abs(found.response.curves - board.response().curves).max() < 0.003
    assert found.recommendations == ()


def test_channels_may_have_different_responses_and_gains():
    board, found = solved(gamma=(1.8, 2.2, 2.5), gain=(0.90, 0.70, 0.50), lateral_frames=False)
    assert np.abs(found.response.curves - board.response().curves).max() < 0.004
    expected = np.array(board.gain) / np.mean(board.gain)
    assert np.abs(found.left.balance - expected).max() < 0.004
    assert np.abs(found.right.crosstalk - MIX[1] * 1.0).max() < 0.003
    assert any("blue is the weakest channel" in line for line in found.recommendations)


def test_marks_in_view_do_not_matter_and_give_the_black_level():
    _, plain = solved(lateral_frames=False)
    _, found = solved(marks=True, lateral_frames=False)
    assert np.abs(found.left.crosstalk - plain.left.crosstalk).max() < 0.002
    assert found.quality["left"]["black_from"] == "marks"
    assert np.abs(found.left.black - 4.0).max() < 0.3


def test_covered_lenses_give_the_black_level():
    board, sequence = WhiteBoard(), color_sequence(PROJECTOR, levels=5, lateral_chromatic=False)
    dark = [tuple(board.image(sequence.frames[0], side, 77, cap=True) for side in (0, 1))]
    found = calibrate_color(board.capture(sequence), sequence, dark=dark)
    assert found.quality["right"]["black_from"] == "lens cap"
    assert np.abs(found.right.black - 4.0).max() < 0.05
    with pytest.raises(ImageError, match="cover the lens"):
        bright = [tuple(np.full_like(p, 40) for p in dark[0])]
        calibrate_color(board.capture(sequence), sequence, dark=bright)


def test_without_other_sources_the_darkest_part_bounds_the_black_level():
    _, found = solved()
    assert found.quality["left"]["black_from"] == "darkest"
    assert (found.left.black > 3.5).all()
    assert (found.left.black < 4 + 0.9 * 0.9 * 1.3 * 5).all()


def test_black_from_marks_needs_marks():
    flat = np.ones((50, 50, 3), np.float32)
    assert black_from_marks(5 * flat, 100 * flat, np.ones((50, 50), bool)) is None


def test_predistorted_fringes_give_the_same_calibration():
    board, plain = solved(lateral_chromatic=LATERAL_CHROMATIC, registration=REGISTRATION)
    sequence = color_sequence(PROJECTOR)
    frames = board.capture(sequence, seed=2, shown=plain.response)
    again = calibrate_color(frames, sequence, calibration=rig(), shown=plain.response)
    assert np.abs(again.left.crosstalk - plain.left.crosstalk).max() < 0.003
    assert np.abs(again.registration.red.shift - plain.registration.red.shift).max() < 0.03


def phase_errors(board, found, side=0):
    check = check_sequence(PATTERN)
    before = [p[side] for p in board.capture(check, seed=5)]
    after = [p[side] for p in board.capture(check, seed=6, shown=found.response)]
    model = (found.left, found.right)[side]
    return (
        phase_error(before, check, encoding=board.encoding),
        phase_error(after, check, encoding=board.encoding, color=model),
    )


@pytest.mark.parametrize("side", [0, 1])
def test_a_fresh_pattern_has_an_eighth_of_the_phase_error_or_less(side):
    before, after = phase_errors(*solved(), side)
    assert before.systematic_rad > 0.1
    assert after.systematic_rad < before.systematic_rad / 8
    assert after.rms_rad < before.rms_rad / 4


def test_unequal_gains_are_corrected_too():
    before, after = phase_errors(*solved(gamma=(1.8, 2.2, 2.5), gain=(0.90, 0.70, 0.50), lateral_frames=False))
    assert before.second_rad > 0.15
    assert after.systematic_rad < before.systematic_rad / 8


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_offsets_of_red_and_blue_are_estimated(encoding):
    """The sum of camera and projector offsets matters, and only that is determined by the images."""
    _, found = solved(lateral_chromatic=LATERAL_CHROMATIC, registration=REGISTRATION, encoding=encoding)
    v, u = np.mgrid[8 : CAMERA[1] : 16, 8 : CAMERA[0] : 16].astype(float)
    pixels = np.stack([u, v], axis=-1)
    for side, (camera, model) in enumerate(zip((rig().left, rig().right), (found.left, found.right), strict=True)):
        for k in (0, 2):
            true = lit_position(pixels, LATERAL_CHROMATIC, REGISTRATION, camera, side, k)
            estimated = lit_position(pixels, model.lateral_chromatic, found.registration, camera, side, k)
            assert np.sqrt(((true - estimated) ** 2).sum(axis=-1).mean()) < 0.025
    quality = found.quality["left"]
    assert quality["lateral_before_px"] > 0.25
    assert quality["lateral_after_px"] < quality["lateral_before_px"] / 4


def lit_position(pixels, lateral_chromatic, registration, camera, side, k):
    at = projected(pixels - lateral_chromatic.at(camera, pixels)[k], side)
    return at - registration.at(PROJECTOR, at)[k]


def test_a_rig_without_lateral_chromatic_aberration_gets_none():
    _, found = solved()
    assert found.left.lateral_chromatic is None
    assert found.right.lateral_chromatic is None
    assert found.registration is None


def test_without_a_calibration_lateral_chromatic_aberration_is_not_estimated():
    board, sequence = WhiteBoard(lateral_chromatic=LATERAL_CHROMATIC), color_sequence(PROJECTOR, levels=5)
    assert calibrate_color(board.capture(sequence), sequence).left.lateral_chromatic is None


def test_cameras_with_different_light_give_a_recommendation():
    board, other, sequence = (
        WhiteBoard(),
        WhiteBoard(gamma=(2.0, 2.2, 2.2)),
        color_sequence(PROJECTOR, levels=5, lateral_chromatic=False),
    )
    mixed = [(a[0], b[1]) for a, b in zip(board.capture(sequence), other.capture(sequence), strict=True)]
    assert any(
        "whole number of the projector's colour cycles" in line
        for line in calibrate_color(mixed, sequence).recommendations
    )


def test_lateral_chromatic_aberration_that_cannot_be_measured_leaves_the_other_results():
    board, sequence = WhiteBoard(), color_sequence(PROJECTOR, levels=5)
    dark = [tuple(np.where(np.arange(CAMERA[0])[:, None] < 28, p, 4).astype(np.uint8) for p in pair)
            for pair in board.capture(sequence)]  # fmt: skip
    found = calibrate_color(dark, sequence, calibration=rig())
    assert found.left.lateral_chromatic is None
    assert "fill the image" in found.quality["lateral_problem"]
    assert np.abs(found.left.crosstalk - MIX[0]).max() < 0.01


def test_several_passes_are_averaged_and_may_show_the_board_elsewhere():
    board, sequence = WhiteBoard(noise=3.0), color_sequence(PROJECTOR, levels=5, lateral_chromatic=False)
    one_pass = calibrate_color(board.capture(sequence), sequence)
    three_passes = calibrate_color([p for seed in range(3) for p in board.capture(sequence, seed=seed)], sequence)
    assert three_passes.quality["left"]["crosstalk_sigma"] < one_pass.quality["left"]["crosstalk_sigma"]


def test_a_solution_is_read_back_from_a_calibration_file():
    _, found = solved(lateral_chromatic=LATERAL_CHROMATIC, registration=REGISTRATION)
    calibration = found.applied(rig())
    again = from_mapping(to_mapping(calibration))
    assert isinstance(again, Calibration)
    assert np.allclose(again.left_color.balance, found.left.balance)
    assert again.left_color.lateral_chromatic.as_mapping() == found.left.lateral_chromatic.as_mapping()
    assert again.registration.as_mapping() == found.registration.as_mapping()
    assert np.array_equal(again.response.curves, found.response.curves)


def sequence_and_images(**options):
    sequence = color_sequence(PROJECTOR, levels=5, lateral_chromatic=False)
    return sequence, WhiteBoard(**options).capture(sequence)


def test_saturated_images_are_refused_with_camera_frame_and_colour():
    sequence = color_sequence(PROJECTOR, levels=5, lateral_chromatic=False)
    with pytest.raises(ImageError, match=r"left camera, frame \d+ \(even light 255 0 0\).* in red .*shorten"):
        calibrate_color(WhiteBoard().capture(sequence, exposure=1.8), sequence)


def test_dark_images_are_refused():
    sequence = color_sequence(PROJECTOR, levels=5, lateral_chromatic=False)
    with pytest.raises(ImageError, match=r"left camera: full red light gives .* lengthen the exposure"):
        calibrate_color(WhiteBoard().capture(sequence, exposure=0.1), sequence)


def test_swapped_colours_are_refused():
    swapped = MIX[:, ::-1]
    sequence, frames = sequence_and_images(mix=swapped + 0.3 * np.eye(3), gain=(0.6, 0.6, 0.6))
    with pytest.raises(ImageError, match="colours of camera or projector are swapped"):
        calibrate_color(frames, sequence)


def test_a_missing_frame_is_refused():
    sequence, frames = sequence_and_images()
    with pytest.raises(ImageError, match="do not make whole passes"):
        calibrate_color(frames[:-1], sequence)


def test_images_of_another_encoding_are_refused():
    sequence, frames = sequence_and_images()
    with pytest.raises(ImageError, match="is no bayer_rggb8 image"):
        calibrate_color(frames, sequence, encoding="bayer_rggb8")


def test_a_check_needs_its_frames():
    check = check_sequence(PATTERN)
    images = [p[0] for p in WhiteBoard().capture(check)]
    with pytest.raises(PatternError, match="expected the frames of check_sequence"):
        phase_error(images[:-1], check)
    with pytest.raises(ImageError, match="fringes are detected on 0 pixels"):
        phase_error(images, check, area=np.zeros(CAMERA[::-1], bool))
