"""Laws of the decoders, three-chip and mosaic, on pictures made here from the formulas alone."""

import numpy as np
import pytest

from pipeline.calibration import ColorModel
from pipeline.noise import estimate
from pipeline.pattern import ColorFringe
from pipeline.phase import Decoder
from pipeline.raw import BAYER, mosaic_of
from pipeline.settings import Settings
from tests.pipeline.rigs import CROSSTALK

SHIFTS = ColorFringe().shifts
COLOR = ColorModel(np.array([3.0, 2.0, 4.0]), CROSSTALK)


def wrapped(a):
    return np.angle(np.exp(1j * a))


def smooth_phase(shape=(120, 160), period=11.0):
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]].astype(float)
    return 2 * np.pi / period * u + 0.4 * np.sin(v / 25) + 0.3 * np.sin(u / 30)


def light(phase, albedo=1.0, ambient=20.0, mean=80.0, amplitude=70.0):
    waves = mean + amplitude * np.cos(phase[..., None] + np.array(SHIFTS))
    return np.asarray(albedo)[..., None] * (waves + ambient) if np.ndim(albedo) else albedo * (waves + ambient)


def picture(phase, noise=0.0, seed=0, color=COLOR, **kwargs):
    counts = light(phase, **kwargs) @ color.crosstalk.T + color.black
    counts = counts + noise * np.random.default_rng(seed).standard_normal(counts.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def mosaic(rgb, encoding):
    v, u = np.mgrid[0 : rgb.shape[0], 0 : rgb.shape[1]]
    channel = np.array(BAYER[encoding])[v & 1, u & 1]
    return np.ascontiguousarray(np.take_along_axis(rgb, channel[..., None], axis=2)[..., 0])


def decoder(encoding="rgb8", color=COLOR, **settings):
    return Decoder(
        color, SHIFTS, mosaic=mosaic_of(encoding), slopes=(2 * np.pi / 11, 0.0), settings=Settings(**settings)
    )


INNER = (slice(8, -8), slice(16, -16))


@pytest.mark.parametrize("radius", [0, 1, 2])
def test_a_three_chip_picture_gives_the_phase_it_was_made_of(radius):
    phase = smooth_phase()
    found = decoder(window_radius=radius).decode(picture(phase))
    error = wrapped(found.phase - phase)[INNER]
    assert np.abs(error).max() < 0.03
    assert found.valid[INNER].all()
    assert np.abs(found.mean[INNER] - 100).max() < 1.5


@pytest.mark.parametrize("encoding", list(BAYER))
@pytest.mark.parametrize("radius", [1, 2])
def test_a_mosaic_gives_the_same_phase_without_demosaicing(encoding, radius):
    phase = smooth_phase()
    found = decoder(encoding, window_radius=radius).decode(mosaic(picture(phase), encoding))
    assert np.abs(wrapped(found.phase - phase)[INNER]).max() < 0.05
    assert np.abs(found.mean[INNER] - 100).max() < 3


@pytest.mark.parametrize("albedo", [0.3, 0.7, 1.2])
@pytest.mark.parametrize("ambient", [0.0, 40.0])
def test_the_phase_knows_neither_albedo_nor_ambient_light(albedo, ambient):
    phase = smooth_phase()
    found = decoder().decode(picture(phase, albedo=albedo, ambient=ambient))
    assert np.abs(wrapped(found.phase - phase)[INNER]).max() < 0.03 / min(albedo, 1)


def test_the_modulation_is_the_amplitude_times_the_albedo():
    found = decoder().decode(picture(smooth_phase(), albedo=0.5))
    assert np.abs(found.modulation[INNER].astype(float) - 35).max() < 3


def test_equalising_takes_the_colour_of_a_surface_away():
    phase = smooth_phase()
    tint = np.array([1.0, 0.55, 0.75])
    counts = (light(phase) * tint) @ CROSSTALK.T + COLOR.black
    found = decoder().decode(np.rint(counts).astype(np.uint8))
    plain = wrapped(found.phase - phase)[INNER]
    equal = wrapped(found.phase_eq - phase)[INNER]
    assert np.sqrt((plain**2).mean()) > 0.15
    assert np.sqrt((equal**2).mean()) < 0.05


def test_without_modulation_nothing_is_valid():
    flat = np.full((60, 80, 3), 120, np.uint8)
    assert not decoder().decode(flat).valid.any()


@pytest.mark.parametrize("radius", [0, 1])
@pytest.mark.parametrize("encoding", ["rgb8", "bayer_grbg8"])
def test_the_predicted_variance_is_the_scatter(radius, encoding):
    if encoding != "rgb8" and radius == 0:
        radius = 2
    phase = smooth_phase()
    dec = decoder(encoding, window_radius=radius, read_noise=2.0)
    errors, variances = [], []
    for seed in range(30):
        rgb = picture(phase, noise=1.98, seed=seed)
        found = dec.decode(rgb if encoding == "rgb8" else mosaic(rgb, encoding))
        errors.append(wrapped(found.phase - phase)[INNER])
        variances.append(found.variance[INNER].mean())
    scatter = np.sqrt(np.stack(errors).var(axis=0).mean())
    predicted = np.sqrt(np.mean(variances))
    assert 0.9 < predicted / scatter < 1.12


def test_clipped_samples_are_left_out_of_the_fit():
    phase = smooth_phase()
    bright = picture(phase, mean=150.0, amplitude=110.0, ambient=10.0, color=ColorModel())
    dec = Decoder(ColorModel(), SHIFTS, mosaic=None, slopes=(2 * np.pi / 11, 0.0), settings=Settings())
    found = dec.decode(bright)
    clipped = (bright >= 254).any(axis=2)[INNER]
    assert 0.1 < clipped.mean() < 0.9
    assert found.clipped > 0.1
    error = np.abs(wrapped(found.phase - phase)[INNER])
    usable = np.isfinite(found.variance[INNER])
    assert usable[clipped].mean() > 0.9
    assert error[clipped & usable].max() < 0.06


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_noise_is_estimated_from_the_picture_alone(encoding):
    rng = np.random.default_rng(5)
    clean = light(smooth_phase((400, 512)), albedo=np.linspace(0.2, 1.2, 400)[:, None] * np.ones(512))
    variance = 0.8**2 + 0.0255 * clean
    rgb = np.clip(np.rint(clean + rng.standard_normal(clean.shape) * np.sqrt(variance)), 0, 255).astype(np.uint8)
    model = estimate(rgb if encoding == "rgb8" else mosaic(rgb, encoding), along=0, step=1 if encoding == "rgb8" else 2)
    for level in (40.0, 100.0, 160.0):
        truth = np.sqrt(0.8**2 + 1 / 12 + 0.0255 * level)
        assert 0.85 < np.sqrt(model.floor + model.gain * level) / truth < 1.15
