"""Gains and contrasts that most surfaces of an image have in common are found, and make no difference to its phase."""

import numpy as np
import pytest

from pipeline.common.settings import Settings
from pipeline.decode.color_cast import NO_CAST, SMALL_GAIN, Cast
from pipeline.decode.decoder import Decoder
from pipeline.decode.raw_image import BAYER, mosaic_of
from tests.pipeline.decode.images import COLOR, INNER, SHIFTS, decoder, light, mosaic, smooth_phase, wrapped

SHAPE = 420, 330
GAINS = np.array([1.3, 1.05, 0.65])
ORANGE = np.array([1.6, 0.7, 0.3])
AMBIENT = np.array([60.0, 30.0, 10.0])


def seen(gains, noise=0.0, ambient=0.0, **kwargs):
    """An image (H, W, 3) of surfaces that reflect the projector's channels by gains, in other light of some colour."""
    counts = (light(smooth_phase(SHAPE), ambient=0.0, **kwargs) + ambient) * gains @ COLOR.crosstalk.T + COLOR.black
    counts = counts + noise * np.random.default_rng(0).standard_normal(counts.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def relative(values):
    return values / np.mean(values)


@pytest.mark.parametrize("encoding", ["rgb8", *BAYER])
def test_gains_of_a_white_surface_are_found(encoding: str) -> None:
    raw = seen(GAINS, noise=1.0, albedo=np.linspace(0.3, 0.9, SHAPE[1]) * np.ones(SHAPE))
    found = decoder(encoding).cast(raw if encoding == "rgb8" else mosaic(raw, encoding))
    np.testing.assert_allclose(relative(found.gains), relative(GAINS), rtol=0.03)
    np.testing.assert_allclose(found.contrasts, 1, atol=0.02)


@pytest.mark.parametrize("encoding", ["rgb8", *BAYER])
def test_contrasts_in_coloured_light_are_found(encoding: str) -> None:
    raw = seen(np.ones(3), noise=1.0, ambient=AMBIENT)
    found = decoder(encoding).cast(raw if encoding == "rgb8" else mosaic(raw, encoding))
    np.testing.assert_allclose(relative(found.gains), relative(80 + AMBIENT), rtol=0.03)
    np.testing.assert_allclose(relative(found.contrasts), relative(1 / (80 + AMBIENT)), rtol=0.04)


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_grbg8"])
def test_gains_of_fringes_across_the_image_are_found(encoding: str) -> None:
    raw = np.ascontiguousarray(seen(GAINS).swapaxes(0, 1))
    turned = Decoder(
        COLOR, SHIFTS, mosaic=mosaic_of(encoding), slopes=(0.0, 2 * np.pi / 11), settings=Settings()
    )  # fmt: skip
    found = turned.cast(raw if encoding == "rgb8" else mosaic(raw, encoding))
    np.testing.assert_allclose(relative(found.gains), relative(GAINS), rtol=0.03)


def small(x):
    return np.exp([x, 0, -x])


@pytest.mark.parametrize("size", [0.0, 0.9 * SMALL_GAIN])
def test_small_gains_are_left(size: float) -> None:
    found = decoder().cast(seen(small(size)))
    np.testing.assert_array_equal(found.gains, 1)
    np.testing.assert_array_equal(found.contrasts, 1)


def test_gains_grow_without_a_jump() -> None:
    at = [decoder().cast(seen(small(x))).gains.max() for x in np.linspace(0, 0.2, 21)]
    assert np.abs(np.diff(at)).max() < 0.03
    assert at[-1] > 1.15


def test_a_strongly_coloured_part_does_not_count() -> None:
    colors = np.where(np.arange(SHAPE[1])[:, None] < 0.4 * SHAPE[1], ORANGE, 1.0)
    found = decoder().cast(seen(GAINS * colors, albedo=0.7))
    np.testing.assert_allclose(relative(found.gains), relative(GAINS), rtol=0.05)


def test_surfaces_of_many_strong_colours_share_none() -> None:
    colors = ORANGE[(np.arange(3) - np.arange(SHAPE[1])[:, None] // 110) % 3]
    assert decoder().cast(seen(colors, albedo=0.7)) is NO_CAST


@pytest.mark.parametrize("light_of", [{"amplitude": 0.0}, {"albedo": 0.02}])
def test_without_fringes_there_is_no_cast(light_of: dict[str, float]) -> None:
    assert decoder().cast(seen(GAINS, noise=1.0, **light_of)) is NO_CAST


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_an_image_without_its_cast_has_the_phase_of_a_white_one(encoding: str) -> None:
    images = seen(np.ones(3), albedo=0.8), seen(GAINS, albedo=0.8), seen(np.ones(3), albedo=0.8, ambient=AMBIENT)
    white, colored, lit = (each if encoding == "rgb8" else mosaic(each, encoding) for each in images)
    made = decoder(encoding, read_noise=1.0)
    expected = made.decode(white)
    phase, normalised = expected.phase.copy(), expected.phase_normalised
    own = 80 + AMBIENT / 0.8
    for raw, cast in ((colored, Cast(GAINS, np.ones(3))), (lit, Cast(relative(own), relative(1 / own)))):
        assert np.abs(wrapped(made.decode(raw).phase - phase))[INNER].max() > 0.1
        found = made.decode(raw, cast)
        assert np.abs(wrapped(found.phase - phase))[INNER].max() < 0.03
        assert np.abs(wrapped(found.phase_normalised - normalised))[INNER].max() < 0.06
    # One image's cast does not hold for the next one.
    np.testing.assert_array_equal(made.decode(white).phase, phase)
