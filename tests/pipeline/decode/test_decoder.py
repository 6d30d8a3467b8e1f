"""Laws of the decoders, three-chip and mosaic, on images made here from the formulas alone."""

import cv2
import numba
import numpy as np
import pytest

from pipeline.common.settings import Settings
from pipeline.decode.decoder import Decoder
from pipeline.decode.kernels.color_gains import limits_of
from pipeline.decode.kernels.local_mean import BoxMean
from pipeline.decode.noise_model import estimate
from pipeline.decode.packed_phasor import PHASOR_SCALE, unpacked
from pipeline.decode.pixel_descriptor import periodic
from pipeline.decode.raw_image import BAYER, mosaic_of
from pipeline.rig.calibration import ColorModel
from tests.pipeline.decode.images import (
    COLOR,
    INNER,
    SHIFTS,
    decoder,
    equal_contrast_of,
    hard_image,
    image,
    levels_of,
    light,
    mosaic,
    normalised_of,
    smooth_phase,
    wrapped,
)
from tests.pipeline.rigs import CROSSTALK


@pytest.mark.parametrize("radius", [0, 1, 2])
def test_a_three_chip_image_gives_the_phase_it_was_made_of(radius):
    phase = smooth_phase()
    found = decoder(window_radius=radius).decode(image(phase))
    error = wrapped(found.phase - phase)[INNER]
    assert np.abs(error).max() < 0.03
    assert found.valid[INNER].all()
    assert np.abs(found.mean[INNER] - 100.0).max() < 1.5


@pytest.mark.parametrize("encoding", list(BAYER))
@pytest.mark.parametrize("radius", [1, 2])
def test_a_mosaic_gives_the_same_phase_without_demosaicing(encoding, radius):
    phase = smooth_phase()
    found = decoder(encoding, window_radius=radius).decode(mosaic(image(phase), encoding))
    assert np.abs(wrapped(found.phase - phase)[INNER]).max() < 0.05
    assert np.abs(found.mean[INNER] - 100.0).max() < 3


@pytest.mark.parametrize("albedo", [0.3, 0.7, 1.2])
@pytest.mark.parametrize("ambient", [0.0, 40.0])
def test_the_phase_depends_on_neither_albedo_nor_ambient_light(albedo, ambient):
    phase = smooth_phase()
    found = decoder().decode(image(phase, albedo=albedo, ambient=ambient))
    assert np.abs(wrapped(found.phase - phase)[INNER]).max() < 0.03 / min(albedo, 1)


def test_the_modulation_is_the_amplitude_times_the_albedo():
    found = decoder().decode(image(smooth_phase(), albedo=0.5))
    assert np.abs(found.modulation[INNER].astype(float) - 35).max() < 3


def test_normalisation_removes_the_bias_of_a_coloured_surface():
    phase = smooth_phase()
    tint = np.array([1.0, 0.55, 0.75])
    counts = (light(phase) * tint) @ CROSSTALK.T + COLOR.black
    found = decoder().decode(np.rint(counts).astype(np.uint8))
    plain = wrapped(found.phase - phase)[INNER]
    equal = wrapped(found.phase_normalised - phase)[INNER]
    assert np.sqrt((plain**2).mean()) > 0.15
    assert np.sqrt((equal**2).mean()) < 0.05


def colored(phase, tint, noise=0.0, seed=0, color=COLOR, **kwargs):
    counts = (light(phase, **kwargs) * np.array(tint)) @ color.crosstalk.T + color.black
    counts = counts + noise * np.random.default_rng(seed).standard_normal(counts.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


STRONG_COLORS = [(0.8, 0.7, 0.1), (0.85, 0.4, 0.1), (0.1, 0.2, 0.6), (0.6, 0.15, 0.15)]


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
@pytest.mark.parametrize("tint", STRONG_COLORS)
def test_the_pointwise_phase_of_a_strongly_coloured_surface_has_no_bias(tint, encoding):
    phase = smooth_phase()
    raw, grey = colored(phase, tint, ambient=10.0), image(phase, albedo=np.mean(tint), ambient=10.0)
    found = decoder(encoding).decode(raw if encoding == "rgb8" else mosaic(raw, encoding))
    assert found.valid[INNER].all()
    assert np.sqrt((wrapped(found.phase - phase)[INNER] ** 2).mean()) < 0.06
    # Mean and modulation are those of a grey surface of the same brightness.
    grey = decoder(encoding).decode(grey if encoding == "rgb8" else mosaic(grey, encoding))
    for ours, theirs in ((found.mean, grey.mean), (found.modulation, grey.modulation)):
        assert np.abs(ours[INNER].astype(float) - theirs[INNER]).mean() < 0.05 * theirs[INNER].mean()


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_grbg8"])
def test_the_predicted_variance_is_the_scatter_on_a_strong_colour_too(encoding):
    phase = smooth_phase()
    dec = decoder(encoding, read_noise=1.0)
    errors, variances = [], []
    for seed in range(30):
        rgb = colored(phase, (0.8, 0.7, 0.15), noise=0.97, seed=seed)
        found = dec.decode(rgb if encoding == "rgb8" else mosaic(rgb, encoding))
        errors.append(wrapped(found.phase - phase)[INNER])
        variances.append(found.variance[INNER].mean())
    assert 0.8 < np.sqrt(np.mean(variances) / np.stack(errors).var(axis=0).mean()) < 1.15


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_a_mildly_coloured_surface_is_decoded_as_without_gains(encoding):
    raw = colored(smooth_phase(), (0.8, 0.6, 0.5), noise=1.0)
    raw = raw if encoding == "rgb8" else mosaic(raw, encoding)
    found = []
    for period_px in (11.0, 1000.0):  # with fringes so wide there are never gains
        dec = decoder(encoding, read_noise=1.0)
        dec._colored_from = limits_of(period_px)
        planes = dec.decode(raw)
        # At the border the local means are those of parts of a period.
        found.append([plane[INNER].copy() for plane in (planes.phase, planes.variance, planes.modulation)])
    (phase, variance, modulation), (plain_phase, plain_variance, plain_modulation) = found
    assert np.abs(wrapped(phase - plain_phase)).max() < 1e-4
    assert np.allclose(variance, plain_variance, rtol=1e-3)
    assert np.abs(modulation.astype(int) - plain_modulation).max() <= 1


def test_saturated_samples_of_a_strong_colour_are_excluded_from_the_fit():
    phase = smooth_phase()
    bright = colored(phase, (1.0, 0.8, 0.15), mean=150.0, amplitude=110.0, ambient=10.0, color=ColorModel())
    dec = Decoder(ColorModel(), SHIFTS, mosaic=None, slopes=(2 * np.pi / 11, 0.0), settings=Settings())
    found = dec.decode(bright)
    saturated = (bright >= 254).any(axis=2)[INNER]
    assert 0.1 < saturated.mean() < 0.9
    error = np.abs(wrapped(found.phase - phase)[INNER])
    usable = np.isfinite(found.variance[INNER])
    assert usable[saturated].mean() > 0.9
    # Clipped channels have smaller means: the gains are those of a paler colour.
    assert np.sqrt((error[usable] ** 2).mean()) < 0.2


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
        rgb = image(phase, noise=1.98, seed=seed)
        found = dec.decode(rgb if encoding == "rgb8" else mosaic(rgb, encoding))
        errors.append(wrapped(found.phase - phase)[INNER])
        variances.append(found.variance[INNER].mean())
    scatter = np.sqrt(np.stack(errors).var(axis=0).mean())
    predicted = np.sqrt(np.mean(variances))
    assert 0.9 < predicted / scatter < 1.12


def ends_of(plane):
    """The outermost pixels of images (..., H, W), and the next ones, each along a row or a column."""
    return {
        f"{name} {k}": part[..., 12:-12]
        for k in (0, 1)
        for name, part in (
            ("left", plane[..., :, k]), ("right", plane[..., :, -1 - k]),
            ("top", plane[..., k, :]), ("bottom", plane[..., -1 - k, :]),
        )
    }  # fmt: skip


@pytest.mark.parametrize(
    ("encoding", "radius"),
    [("rgb8", 0), ("rgb8", 1), ("rgb8", 2), ("bayer_rggb8", 1), ("bayer_rggb8", 2), ("bayer_gbrg8", 2)],
)
@pytest.mark.parametrize(("period", "slant"), [(11.0, 0.0), (12.5, 0.05), (14.0, -0.04)])
def test_the_image_s_last_pixels_have_a_phase_and_its_variance(encoding, radius, period, slant):
    v, u = np.mgrid[0:200, 0:240]
    phase = 2 * np.pi / period * u + slant * v
    dec = decoder(encoding, window_radius=radius, read_noise=2.0)
    errors, variances = [], []
    for seed in range(4):
        rgb = image(phase, noise=1.98, seed=seed)
        found = dec.decode(rgb if encoding == "rgb8" else mosaic(rgb, encoding))
        assert found.valid.all()
        errors.append(wrapped(found.phase - phase))
        variances.append(found.variance.copy())
    errors, variances = ends_of(np.stack(errors)), ends_of(np.stack(variances))
    for name, error in errors.items():
        ratio = np.sqrt(np.mean(error**2 / variances[name]))
        assert 0.75 < ratio < 1.45, name


@pytest.mark.parametrize("shape", [(24, 40), (13, 17), (3, 9)])
@pytest.mark.parametrize("radius", [1, 2])
@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_small_images_are_decoded_up_to_their_ends(shape, radius, encoding):
    v, u = np.mgrid[0 : shape[0], 0 : shape[1]]
    phase = 2 * np.pi / 11 * u + 0.02 * v
    rgb = image(phase)
    found = decoder(encoding, window_radius=radius).decode(rgb if encoding == "rgb8" else mosaic(rgb, encoding))
    assert found.valid.all()
    assert np.abs(wrapped(found.phase - phase)).max() < 0.05


def test_saturated_pixels_at_the_image_s_ends_are_fitted():
    phase = smooth_phase((40, 64))
    bright = image(phase, mean=150.0, amplitude=110.0, ambient=10.0, color=ColorModel())
    dec = Decoder(ColorModel(), SHIFTS, mosaic=None, slopes=(2 * np.pi / 11, 0.0), settings=Settings())
    found = dec.decode(bright)
    ends = np.ones(phase.shape, bool)
    ends[1:-1, 1:-1] = False
    here = ends & (bright >= 254).any(axis=2) & np.isfinite(found.variance)
    assert here.sum() > 0.3 * ends.sum()
    assert np.abs(wrapped(found.phase - phase))[here].max() < 0.1


def test_saturated_samples_are_excluded_from_the_fit():
    phase = smooth_phase()
    bright = image(phase, mean=150.0, amplitude=110.0, ambient=10.0, color=ColorModel())
    dec = Decoder(ColorModel(), SHIFTS, mosaic=None, slopes=(2 * np.pi / 11, 0.0), settings=Settings())
    found = dec.decode(bright)
    saturated = (bright >= 254).any(axis=2)[INNER]
    assert 0.1 < saturated.mean() < 0.9
    assert found.saturated > 0.1
    error = np.abs(wrapped(found.phase - phase)[INNER])
    usable = np.isfinite(found.variance[INNER])
    assert usable[saturated].mean() > 0.9
    assert error[saturated & usable].max() < 0.06


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_noise_is_estimated_from_the_image_alone(encoding):
    rng = np.random.default_rng(5)
    clean = light(smooth_phase((400, 512)), albedo=np.linspace(0.2, 1.2, 400)[:, None] * np.ones(512))
    variance = 0.8**2 + 0.0255 * clean
    rgb = np.clip(np.rint(clean + rng.standard_normal(clean.shape) * np.sqrt(variance)), 0, 255).astype(np.uint8)
    model = estimate(rgb if encoding == "rgb8" else mosaic(rgb, encoding), along=0, step=1 if encoding == "rgb8" else 2)
    for level in (40.0, 100.0, 160.0):
        truth = np.sqrt(0.8**2 + 1 / 12 + 0.0255 * level)
        assert 0.85 < np.sqrt(model.floor + model.gain * level) / truth < 1.15


@pytest.mark.parametrize("encoding", ["rgb8", *BAYER])
def test_the_normalised_phase_is_correct_up_to_the_border(encoding):
    rgb = hard_image((72, 94))
    if encoding == "rgb8":
        raw, levels = rgb, levels_of(rgb)
        sharp = levels
    else:
        raw = mosaic(rgb, encoding)
        v, u = np.mgrid[0 : raw.shape[0], 0 : raw.shape[1]]
        own = np.eye(3)[np.array(BAYER[encoding])[v & 1, u & 1]]
        kernel = np.outer([1.0, 2.0, 1.0], [1.0, 2.0, 1.0])
        total, count = (cv2.filter2D(p, -1, kernel) for p in (own * raw[..., None], own))
        levels = total / count - COLOR.black
        sharp = equal_contrast_of(levels, own)
    found = decoder(encoding).decode(raw)
    # Sums of 16 bits: a part in ten thousand of a bright mean, more of a dark one.
    bright = cv2.erode((levels.min(axis=2) > 10).astype(np.uint8), np.ones((9, 21))) > 0
    assert bright.mean() > 0.2
    expected = normalised_of(levels, sharp)
    # Rounded to 2048 steps of a turn, and what the means are off by.
    away = np.abs(wrapped(found.phase_normalised - np.angle(expected)))
    assert (away < np.pi / 2048 + 2e-3 / np.maximum(np.abs(expected), 0.05))[bright & (np.abs(expected) > 0.05)].all()
    assert bright[0].any() and bright[:, 0].any() and bright[-1].any()


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("encoding", list(BAYER))
def test_the_normalised_phase_of_a_mosaic_has_no_error_that_changes_from_pixel_to_pixel(encoding, axis):
    """Colours of unequal contrast cause one of twice the phase, 0.026 rad where neighbours' means are taken as such."""
    period = 15.0
    phase = 2 * np.pi / period * np.mgrid[0:90, 0:130][1 if axis == "x" else 0]
    slopes = (2 * np.pi / period, 0.0) if axis == "x" else (0.0, 2 * np.pi / period)
    made = Decoder(COLOR, SHIFTS, mosaic=mosaic_of(encoding), slopes=slopes, settings=Settings())
    error = wrapped(made.decode(mosaic(image(phase), encoding)).phase_normalised - phase)
    for rows in range(2):
        for columns in range(2):
            part = np.s_[20 + rows : -20 : 2, 20 + columns : -20 : 2]
            assert abs((error[part] * np.exp(2j * phase[part])).mean()) < 0.006


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_a_periodic_error_is_subtracted_from_the_normalised_phase_alone(encoding):
    rgb = image(smooth_phase())
    raw = rgb if encoding == "rgb8" else mosaic(rgb, encoding)
    made = decoder(encoding)
    before = made.decode(raw)
    kept = {name: np.array(getattr(before, name)) for name in PLANES}
    error = np.array([0.01, -0.02, 0.03, 0.05, -0.1, 0.02])
    made.correct(error)
    after = made.decode(raw)
    expected = periodic(kept["phase_normalised"].ravel()).reshape(*rgb.shape[:2], 6) @ error
    np.testing.assert_allclose(
        wrapped(kept["phase_normalised"] - after.phase_normalised), expected, atol=1.001 * np.pi / 2**11
    )
    for name in set(PLANES) - {"descriptors", "phase_normalised"}:
        np.testing.assert_array_equal(getattr(after, name), kept[name])
    made.correct(np.zeros(6))
    np.testing.assert_array_equal(made.decode(raw).descriptors, kept["descriptors"])


PLANES = ("phasor", "descriptors", "mean", "variance", "phase", "phase_normalised", "modulation", "valid")


@pytest.mark.threads
@pytest.mark.parametrize("encoding", ["rgb8", "bayer_gbrg8"])
def test_the_result_does_not_depend_on_the_number_of_threads(encoding):
    raw = hard_image()
    raw = raw if encoding == "rgb8" else mosaic(raw, encoding)
    dec, threads = decoder(encoding), numba.get_num_threads()
    found = []
    try:
        for n in (1, numba.config.NUMBA_NUM_THREADS):
            numba.set_num_threads(n)
            map_ = dec.decode(raw)
            found.append([getattr(map_, name).copy() for name in PLANES])
    finally:
        numba.set_num_threads(threads)
    for one, all_ in zip(*found, strict=True):
        assert np.array_equal(one, all_, equal_nan=True)


@pytest.mark.parametrize("level", [0, 255])
@pytest.mark.parametrize("encoding", ["rgb8", "bayer_gbrg8"])
def test_black_and_white_images_have_no_phase_and_no_nan(encoding, level):
    found = decoder(encoding).decode(np.full((40, 64, 3) if encoding == "rgb8" else (40, 64), level, np.uint8))
    assert not found.valid.any()
    assert found.saturated == (level == 255)
    assert not any(np.isnan(getattr(found, name)).any() for name in PLANES)


@pytest.mark.parametrize("shape", [(6, 40), (13, 33), (35, 200)])
@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_small_images_are_decoded_as_parts_of_large_ones(encoding, shape):
    rgb = image(smooth_phase((60, 240)), noise=1.0)
    whole, part = (x if encoding == "rgb8" else mosaic(x, encoding) for x in (rgb, rgb[: shape[0], : shape[1]]))
    small = decoder(encoding, read_noise=1.0).decode(np.ascontiguousarray(part))
    large = decoder(encoding, read_noise=1.0).decode(whole)
    inner = (slice(3, shape[0] - 3), slice(3, shape[1] - 3))
    for name in ("mean", "variance", "phase", "modulation", "valid"):
        np.testing.assert_allclose(getattr(small, name)[inner], getattr(large, name)[inner], rtol=1e-5, atol=1e-5)
    one, other = (unpacked(found.phasor[inner], PHASOR_SCALE) for found in (small, large))
    assert (np.abs(one - other) < 1.5 / PHASOR_SCALE).all()


def test_the_modulation_is_kept_when_the_next_image_is_decoded():
    dec = decoder()
    first = dec.decode(hard_image())
    kept = first.modulation.copy()
    dec.decode(image(smooth_phase((90, 131)), albedo=0.3))
    assert np.array_equal(first.modulation, kept)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("period", [3.0, 11.0, 40.0, 300.0])
def test_the_box_mean_of_any_period_fits_16_bits(axis, period):
    for largest in (255, 255 * 8):
        box = BoxMean.of(period, (640, 512), axis=axis, largest=largest)
        total = largest
        for extent, drop in zip((box.over, box.over, box.along, box.along), box.drops, strict=True):
            total = ((total + (1 << drop >> 1)) >> drop) * extent
            assert total < 2**16 and drop < 16
        assert total * box.scale == pytest.approx(largest, rel=0.01)


@pytest.mark.parametrize("period", [17.0, 45.0])
def test_long_periods_across_the_rows_are_normalised_as_well(period):
    v = np.arange(160)[:, None] + np.zeros((1, 40))
    phase = 2 * np.pi * v / period
    slopes = (0.0, 2 * np.pi / period)
    tint = np.array([1.3, 1.0, 0.7])
    light = 20 + 55 * tint * (1 + 0.9 * np.cos(phase[..., None] + np.array(SHIFTS)))
    raw = np.clip(np.rint(light), 0, 255).astype(np.uint8)
    color = ColorModel(np.full(3, 20.0), np.eye(3))
    found = Decoder(color, SHIFTS, mosaic=None, slopes=slopes, settings=Settings()).decode(raw)
    whole = slice(int(period), 160 - int(period))
    assert np.abs(wrapped(found.phase_normalised - phase)[whole, 2:-2]).max() < 0.1
    assert np.abs(wrapped(found.phase - phase)[whole, 2:-2]).max() > 0.15
