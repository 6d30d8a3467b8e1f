"""The colour of a single shot, against the albedo of the simulator's surfaces and against fringes of known colour."""

import cv2
import numpy as np
import pytest

from pipeline.common.settings import Settings
from pipeline.decode.decoder import Decoder
from pipeline.decode.raw_image import mosaic_of
from pipeline.rig.calibration import ColorModel
from tests.pipeline.albedo import albedo_errors
from tests.pipeline.rigs import CROSSTALK
from tests.pipeline.small import images, pair, reconstructor

SHIFTS = (-2 * np.pi / 3, 0.0, 2 * np.pi / 3)
COLOR = ColorModel(np.array([3.0, 4.0, 5.0]), CROSSTALK, balance=np.array([1.2, 1.0, 0.8]))
PERIOD, SIZE = 11.0, (160, 120)


def fringe(albedo, axis="x", encoding="rgb8", light=100.0):
    """Raw image of a surface of one albedo, (3,) or (H, W, 3), under the fringe."""
    width, height = SIZE
    along = np.indices((height, width))[1 if axis == "x" else 0] * 2 * np.pi / PERIOD
    reflected = light * np.asarray(albedo) * (1 + 0.9 * np.cos(along[..., None] + np.array(SHIFTS)))
    counts = np.rint(reflected @ COLOR.mix.T + COLOR.black).clip(0, 255).astype(np.uint8)
    if encoding == "rgb8":
        return counts
    cell = np.tile(mosaic_of(encoding), (height // 2, width // 2))
    return np.ascontiguousarray(np.take_along_axis(counts, cell[..., None], axis=2)[..., 0])


def decoder(axis="x", encoding="rgb8"):
    slopes = (2 * np.pi / PERIOD, 0.0) if axis == "x" else (0.0, 2 * np.pi / PERIOD)
    return Decoder(COLOR, SHIFTS, mosaic=mosaic_of(encoding), slopes=slopes, settings=Settings())


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8", "bayer_gbrg8"])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("albedo", [(0.9, 0.9, 0.9), (0.9, 0.5, 0.3), (0.2, 0.4, 0.9)])
def test_an_even_surface_has_its_color_without_fringes(albedo, axis, encoding):
    found = decoder(axis, encoding).color(fringe(albedo, axis, encoding)).astype(float)
    # The first guess of a mosaic blurs the fringes, which costs some of their amplitude and evenness.
    limit = 1.0 if encoding == "rgb8" else 5.0
    error = np.abs(found - 100 * np.array(albedo))
    assert error[12:-12, 12:-12].max() <= limit
    assert error.mean() < limit


def test_brightness_is_as_sharp_as_the_image():
    albedo = np.full((*SIZE[::-1], 3), 0.8)
    albedo[40:80, 60:66] = 0.3
    found = decoder().color(fringe(albedo))
    assert found[45:75, 61:65].max() < 45 and found[45:75, 55:59].min() > 60


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("albedo", [(0.9, 0.6, 0.5), (0.5, 0.7, 0.8)])
def test_the_brightness_of_a_coloured_surface_is_its_mean_without_fringes(albedo, axis, encoding):
    found = decoder(axis, encoding).decode(fringe(albedo, axis, encoding))
    inner = np.s_[12:-12, 12:-12]
    brightness, mean = (x[inner].astype(float) for x in (found.brightness, found.mean))
    assert np.abs(brightness - 100 * np.mean(albedo)).max() < (1.5 if encoding == "rgb8" else 5)
    assert np.ptp(brightness) < 0.4 * np.ptp(mean)


def test_the_decoded_brightness_is_as_sharp_as_the_image():
    albedo = np.full((*SIZE[::-1], 3), 0.8)
    albedo[40:80, 60:] = 0.3
    brightness = decoder().decode(fringe(albedo)).brightness[45:75].astype(float)
    assert brightness[:, 59].min() > 1.5 * brightness[:, 60].max()


def test_colors_leave_the_phases_of_the_same_decoder_alone():
    one, image = decoder(), fringe((0.7, 0.6, 0.5))
    phase = one.decode(image).phase.copy()
    map_ = one.decode(image)
    one.color(fringe((0.1, 0.9, 0.4)))
    np.testing.assert_array_equal(map_.phase, phase)


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_colors_of_a_measured_scene_are_the_albedo_of_its_surfaces(encoding):
    """Away from edges: where the mean over a period meets no other surface, shadow or end of the light."""
    left, _ = images(pair("isolated", 0, encoding))
    rgb = reconstructor(encoding=encoding).color(left)
    truth = pair("isolated", 0, encoding).truth_left
    error, albedo = albedo_errors("isolated", rgb)
    depth = np.nan_to_num(truth.xyz[..., 2])
    step = cv2.morphologyEx(depth, cv2.MORPH_GRADIENT, np.ones((3, 3))) > 20
    inside = cv2.erode((truth.lit & ~step).astype(np.uint8), np.ones((15, 15))) > 0
    assert inside.sum() > 1000 and np.ptp(albedo[inside], axis=1).max() > 0.3
    assert error[inside].mean() < 0.03
