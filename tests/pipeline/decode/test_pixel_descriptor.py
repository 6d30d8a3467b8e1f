"""Laws of what the order search compares of a pixel."""

import numpy as np
import pytest

from pipeline.common.jit import serial
from pipeline.decode import pixel_descriptor
from tests.pipeline.decode.images import decoder, hard_image, mosaic, wrapped

PHASE_ERROR, NORMALISED_ERROR = 1.001 * np.pi / 2**12, 1.001 * np.pi / 2**11
UNIT = 2 * np.pi / 2**32


@serial
def read(plane, phase, equal, mean, valid):
    for j in range(plane.shape[0]):
        x = plane[j]
        phase[j], equal[j], mean[j] = (
            pixel_descriptor.phase_units(x),
            pixel_descriptor.normalised_units(x),
            pixel_descriptor.mean_of(x),
        )
        valid[j] = np.int32(x & pixel_descriptor.VALID) != 0


@serial
def differences(one, other, out):
    for j in range(one.shape[0]):
        out[j] = np.int32(pixel_descriptor.phase_units(one[j]) - pixel_descriptor.units(other[j]))


@serial
def biases(plane, phase, out):
    for j in range(plane.shape[0]):
        out[j] = pixel_descriptor.bias_of(plane[j], phase[j])


def made(phase, equal, valid, mean):
    out = np.empty(len(phase), np.int32)
    size = np.float32(0.3)
    pixel_descriptor.normalised_phase_row(
        size * np.cos(equal, dtype=np.float32), size * np.sin(equal, dtype=np.float32), out
    )
    pixel_descriptor.complete_row(phase, valid, mean, out)
    return out


def drawn(n=20_000):
    rng = np.random.default_rng(8)
    phase, equal = rng.uniform(-np.pi, np.pi, (2, n)).astype(np.float32)
    phase[:4] = np.pi, -np.pi, 0, np.nextafter(np.float32(np.pi), np.float32(0))
    equal[:4] = -np.pi, np.pi, np.pi / 2, 0
    return phase, equal, rng.random(n) < 0.5, rng.integers(0, 256, n).astype(np.uint8)


def test_every_field_of_a_descriptor_is_recovered():
    phase, equal, valid, mean = drawn()
    plane = made(phase, equal, valid, mean)
    found = [np.empty(len(plane), kind) for kind in (np.int32, np.int32, np.float32, np.bool_)]
    read(plane, *found)
    assert np.abs(wrapped(found[0] * UNIT - phase)).max() <= PHASE_ERROR
    assert np.abs(wrapped(found[1] * UNIT - equal)).max() <= NORMALISED_ERROR
    assert np.array_equal(found[2], mean) and np.array_equal(found[3], valid)
    assert np.abs(wrapped(pixel_descriptor.normalised_phase(plane) - equal)).max() <= NORMALISED_ERROR


def test_differences_of_phases_wrap():
    phase, equal, valid, mean = drawn()
    other = np.roll(phase, 7)
    found = np.empty(len(phase), np.int32)
    differences(made(phase, equal, valid, mean), other, found)
    assert np.abs(wrapped(found * UNIT - (phase - other))).max() < PHASE_ERROR + 1e-6


def test_the_bias_is_the_difference_of_both_phases_within_half_a_turn():
    phase, equal, valid, mean = drawn()
    found = np.empty(len(phase), np.float32)
    biases(made(phase, equal, valid, mean), phase, found)
    assert np.abs(wrapped(found - (equal - phase))).max() <= NORMALISED_ERROR + 1e-6
    assert np.abs(found).max() <= np.pi + 1e-6


@pytest.mark.parametrize("encoding", ["rgb8", "bayer_rggb8"])
def test_a_decoder_writes_every_pixel_of_them(encoding):
    raw = hard_image()
    found = decoder(encoding).decode(raw if encoding == "rgb8" else mosaic(raw, encoding))
    phase, equal, mean, valid = (np.empty(raw[..., 0].size, k) for k in (np.int32, np.int32, np.float32, np.bool_))
    read(found.descriptors.ravel(), phase, equal, mean, valid)
    assert np.abs(wrapped(phase * UNIT - found.phase.ravel())).max() <= PHASE_ERROR
    assert np.array_equal(mean, found.mean.ravel()) and np.array_equal(valid, found.valid.ravel())
    assert 0.2 < valid.mean() < 1


@pytest.mark.parametrize(
    "factor", [(2.5, 0, 0, 0, 0, 0, 0), (1, 0, 0, 0, 0, 0, 0), (0.9, 0.2, -0.1, 0.3, -0.05, 0.1, 0.07)]
)
def test_means_and_normalised_phases_are_corrected_and_nothing_else(factor):
    rng = np.random.default_rng(5)
    plane = rng.integers(-(2**31), 2**31, (7, 300), dtype=np.int64).astype(np.int32)
    plane[0, :256] = np.arange(256)
    before = plane.copy()
    error = np.array([0.02, 0.0, -0.1, 0.05, 0.0, 0.1])
    table = pixel_descriptor.correction_table(error)
    pixel_descriptor.correct_descriptors(7, table, np.array(factor, np.float32), plane)
    rest = ~(255 | 0x7FF << 9)
    np.testing.assert_array_equal(plane & rest, before & rest)
    v, u = np.indices(plane.shape)
    values = pixel_descriptor.over_the_image(u.ravel(), v.ravel(), plane.shape[::-1]) @ factor
    means = np.minimum((before & 255) * values.reshape(plane.shape), 255)
    assert np.abs((plane & 255) - means).max() < 0.501
    phase = pixel_descriptor.normalised_phase(before).ravel().astype(np.float64)
    expected = phase - pixel_descriptor.periodic(phase) @ error
    away = wrapped(pixel_descriptor.normalised_phase(plane).ravel() - expected)
    assert np.abs(away).max() <= NORMALISED_ERROR
