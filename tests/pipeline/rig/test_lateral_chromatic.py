"""Lateral colour and registration: in the file, as angles of the channels, in both decoders and in the cloud."""

import copy
import dataclasses

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError
from pipeline.common.settings import Settings
from pipeline.decode.chromatic_phase import STEP, ChromaticCorrection, channel_angles, chromatic_correction
from pipeline.decode.decoder import Decoder
from pipeline.decode.raw_image import mosaic_of
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.reconstruct.reconstructor import Reconstructor
from pipeline.rig.calibration import Calibration, ColorModel, from_mapping, to_mapping
from pipeline.rig.lateral_chromatic import ColorDisplacement, ColorOffset, LateralChromatic, Registration
from sim.evaluate.score import score
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.pipeline.decode.images import COLOR, INNER, SHIFTS, decoder, mosaic, smooth_phase, wrapped
from tests.pipeline.rigs import rig
from tests.pipeline.small import LAYOUT, PERIODS, SETTINGS
from tests.renders import render_pair

LATERAL_CHROMATIC = LateralChromatic(
    ColorDisplacement(np.array([0.1, -0.2]), -1e-3, 0.02), ColorDisplacement(np.array([0.0, 0.1]), 1e-3)
)
REGISTRATION = Registration(ColorOffset(np.array([0.3, 0.0])), ColorOffset(np.array([-0.2, 0.1]), 1e-4 * np.eye(2)))
PATTERN = ColorFringe((320, 256), 24)


def with_colors(lateral_chromatic=LATERAL_CHROMATIC, registration=REGISTRATION):
    plain = rig()
    color = dataclasses.replace(plain.left_color, lateral_chromatic=lateral_chromatic)
    return dataclasses.replace(plain, left_color=color, registration=registration)


def test_both_go_through_a_calibration_file_and_stay_away_when_absent():
    again = from_mapping(to_mapping(with_colors()))
    assert again.left_color.lateral_chromatic.as_mapping() == LATERAL_CHROMATIC.as_mapping()
    assert again.right_color.lateral_chromatic is None
    assert again.registration.as_mapping() == REGISTRATION.as_mapping()
    plain = to_mapping(rig())
    assert "lateral" not in plain["cameras"]["left"]["color"]
    assert "balance" not in plain["cameras"]["left"]["color"]
    assert "registration" not in plain["projector"]


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (("cameras", "left", "color", "lateral"), 3, r"cameras\.left\.color\.lateral is not a mapping"),
        (("cameras", "left", "color", "lateral"), {"red": 1}, r"lateral\.red is not a mapping"),
        (
            ("cameras", "left", "color", "lateral", "blue", "shift"),
            [1],
            r"lateral\.blue\.shift must be 2 finite numbers",
        ),
        (("cameras", "left", "color", "lateral", "blue", "shift"), ["a", 1], r"lateral\.blue\.shift is not made of"),
        (("cameras", "left", "color", "lateral", "red", "magnification"), 0.5, r"red\.magnification is 0.5, more than"),
        (
            ("cameras", "left", "color", "lateral", "red", "cubic"),
            float("nan"),
            r"red\.cubic must be one finite number",
        ),
        (("projector", "registration", "red", "stretch"), [1, 2], r"registration\.red\.stretch must be 2 x 2 finite"),
        (("projector", "registration", "red", "shift"), [20, 0], r"registration\.red\.shift is .* limit of 8 px"),
        (("cameras", "left", "color", "balance"), [1, 1], r"cameras\.left\.color\.balance must be three numbers"),
        (("cameras", "left", "color", "balance"), [1, 1, 0], r"color\.balance must be three numbers from 0\.05"),
    ],
)
def test_errors_in_the_file_name_the_key(path, value, message):
    data = copy.deepcopy(to_mapping(with_colors()))
    at = data
    for key in path[:-1]:
        at = at[key]
    at[path[-1]] = value
    with pytest.raises(CalibrationError, match=message):
        from_mapping(data)


def test_a_red_point_is_displaced_by_the_model():
    """A tenth of a per cent at 100 px from the principal point is a tenth of a pixel, away from it."""
    camera = rig().left
    centre = camera.matrix[:2, 2]
    model = LateralChromatic(red=ColorDisplacement(magnification=1e-3))
    moved = model.at(camera, centre + np.array([100.0, 0.0]))
    assert np.allclose(moved, [[0.1, 0], [0, 0], [0, 0]])


def test_the_channels_angles_are_the_phases_of_where_their_light_comes_from():
    calibration = with_colors()
    pixels = np.array([[20.0, 30.0], [128.0, 100.0], [240.0, 190.0]])
    angles = channel_angles(calibration, PATTERN, calibration.left_color, 1400.0, pixels)
    rays = np.concatenate([calibration.left.normalise(pixels), np.ones((3, 1))], axis=1)
    for k in (0, 2):
        # Light that leaves the projector at p lands at p + offset and is seen displaced in the image.
        shift = LATERAL_CHROMATIC.at(calibration.left, pixels)[k]
        from_green = np.concatenate([calibration.left.normalise(pixels - shift), np.ones((3, 1))], axis=1)
        landed = calibration.projector.project(1400 * from_green)
        sent = landed - REGISTRATION.at(PATTERN.size, landed)[k]
        here = calibration.projector.project(1400 * rays)
        expected = 2 * np.pi * 24 / 320 * (sent - here)[:, 0]
        assert np.allclose(angles[k], expected, atol=1e-9)
    assert np.allclose(angles[1], 0)


def test_a_pure_shift_of_the_projectors_colours_needs_no_table():
    calibration = with_colors(None, Registration(ColorOffset(np.array([0.3, 0.0])), ColorOffset()))
    chromatic = chromatic_correction(calibration, PATTERN, calibration.left_color, 1400.0)
    assert chromatic.step == 0
    expected = np.array(PATTERN.shifts) - np.array([0.3 * 2 * np.pi * 24 / 320, 0, 0])
    assert np.allclose(chromatic.shifts, expected)


def test_without_either_there_is_no_table():
    chromatic = chromatic_correction(rig(), PATTERN, rig().left_color, 1400.0)
    assert chromatic.step == 0
    assert chromatic.shifts == PATTERN.shifts


def angles_at(v, u, shape):
    """Angles of red and blue that change over the image, (3, ...)."""
    x, y = 2 * u / shape[1] - 1, 2 * v / shape[0] - 1
    return np.stack([0.05 + 0.15 * x - 0.04 * y, 0 * x, 0.02 - 0.12 * x + 0.05 * x * y])


def turned_image(phase, encoding):
    v, u = np.mgrid[0 : phase.shape[0], 0 : phase.shape[1]].astype(float)
    delta = np.array(SHIFTS)[:, None, None] + angles_at(v, u, phase.shape)
    light = np.moveaxis(80 + 70 * np.cos(phase + delta) + 20, 0, -1)
    rgb = np.clip(np.rint(light @ COLOR.crosstalk.T + COLOR.black), 0, 255).astype(np.uint8)
    return rgb if encoding == "rgb8" else mosaic(rgb, encoding)


def correction_for(shape):
    rows = STEP * np.arange((shape[0] - 1) // STEP + 2.0)
    v, u = np.meshgrid(rows, np.arange(shape[1], dtype=float), indexing="ij")
    return ChromaticCorrection.of(SHIFTS, angles_at(v, u, shape))


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
@pytest.mark.parametrize("radius", [1, 2])
def test_chromatic_correction_recovers_the_phase(encoding, radius):
    phase = smooth_phase()
    raw = turned_image(phase, encoding)
    plain = decoder(encoding, window_radius=radius).decode(raw)
    before = np.abs(wrapped(plain.phase - phase)[INNER]).max()
    straight = Decoder(
        COLOR, SHIFTS, mosaic=mosaic_of(encoding), slopes=(2 * np.pi / 11, 0.0),
        settings=Settings(window_radius=radius), chromatic=correction_for(phase.shape),
    )  # fmt: skip
    found = straight.decode(raw)
    error = np.abs(wrapped(found.phase - phase)[INNER])
    assert before > 0.07
    assert error.max() < (0.03 if encoding == "rgb8" else 0.05)
    assert np.abs(found.mean[INNER] - 100.0).max() < (1.5 if encoding == "rgb8" else 3)
    equal = np.abs(wrapped(found.phase_normalised - phase)[INNER])
    assert np.sqrt((equal**2).mean()) < 0.05


def test_balance_corrects_unequal_channels_in_the_phase():
    phase, gains = smooth_phase(), np.array([1.2, 1.0, 0.8])
    light = np.moveaxis(80 + 70 * np.cos(phase + np.array(SHIFTS)[:, None, None]), 0, -1) + 20
    raw = np.rint(light * gains @ COLOR.crosstalk.T + COLOR.black).astype(np.uint8)
    evened = dataclasses.replace(COLOR, balance=gains)
    found = decoder(color=evened).decode(raw)
    assert np.abs(wrapped(found.phase - phase)[INNER]).max() < 0.03
    assert np.abs(wrapped(decoder().decode(raw).phase - phase)[INNER]).max() > 0.1
    assert np.abs(found.mean[INNER] - 100.0).max() < 1.5


def displaced_rig(chromatic, shift):
    """The simulator's lens and projector errors as a calibration."""
    calibration = LAYOUT.calibration_for(Optics())

    def color(model: ColorModel) -> ColorModel:
        red, blue = (ColorDisplacement(magnification=m) for m in (-chromatic, chromatic))
        return dataclasses.replace(model, lateral_chromatic=LateralChromatic(red, blue))

    offsets = Registration(ColorOffset(np.array([shift, 0.0])), ColorOffset(np.array([-shift, 0.0])))
    return Calibration(
        calibration.left, calibration.right, calibration.projector, color(calibration.left_color),
        color(calibration.right_color), calibration.response, offsets,
    )  # fmt: skip


def measured(calibration, pair, encoding):
    """Cloud, and rms phase error of both cameras away from the border, of a rendered pair."""
    pattern = LAYOUT.pattern(PERIODS)
    made = Reconstructor(calibration, pattern, LAYOUT.volume(), encoding=encoding, settings=SETTINGS)
    squares = []
    images, truths = (pair.left, pair.right), (pair.truth_left, pair.truth_right)
    for own, shown, truth in zip(made.decoders, images, truths, strict=True):
        true = 2 * np.pi * PERIODS * (truth.projector[..., 0] + 0.5) / pattern.length
        squares.append(wrapped(own.decode(shown).phase - true)[20:-20, 40:-40] ** 2)
    return made.reconstruct(pair.left, pair.right), float(np.sqrt(np.nanmean(squares)))


@pytest.mark.parametrize(("encoding", "gain"), [("rgb8", 10), ("bayer_rggb8", 4)])
def test_lateral_chromatic_aberration_and_registration_are_corrected_in_the_phase(encoding, gain):
    chromatic, shift = 4e-3, 0.3
    optics = Optics(chromatic=chromatic, color_shift_px=(shift, 0.0, -shift), noise=0.0)
    pair = render_pair(LAYOUT, build("plane"), LAYOUT.pattern(PERIODS), optics, encoding=encoding)
    _, before = measured(LAYOUT.calibration_for(optics), pair, encoding)
    _, after = measured(displaced_rig(chromatic, shift), pair, encoding)
    assert before > 0.05
    assert after < before / gain


def test_chromatic_correction_improves_a_plane():
    chromatic, shift = 4e-3, 0.3
    optics = Optics(chromatic=chromatic, color_shift_px=(shift, 0.0, -shift), noise=0.3)
    pair = render_pair(LAYOUT, build("plane"), LAYOUT.pattern(PERIODS), optics)
    without = render_pair(LAYOUT, build("plane"), LAYOUT.pattern(PERIODS), Optics(noise=0.3))
    plain = LAYOUT.calibration_for(optics)
    scores = [
        score(measured(calibration, shown, "rgb8")[0].xyz, pair.truth_left)
        for calibration, shown in ((plain, without), (plain, pair), (displaced_rig(chromatic, shift), pair))
    ]
    # Where the surface's colour changes, the displaced channels see different surfaces, which no angle corrects.
    for name, share in (("smooth_rms_mm", 0.1), ("rms_mm", 0.3)):
        floor, before, after = np.square([getattr(one, name) for one in scores])
        assert after - floor < share * (before - floor)
