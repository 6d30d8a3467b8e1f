"""Laws of phasors in four bytes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.common.jit import serial
from pipeline.decode.packed_phasor import PHASOR_SCALE, imaginary, pack, real, unpacked

SCALES = PHASOR_SCALE, np.float32(8192)
MOST = 32767


@serial
def packed_all(re, im, scale, out):
    for j in range(re.shape[0]):
        out[j] = pack(re[j], im[j], scale)


@serial
def units_of_all(plane, re, im):
    for j in range(plane.shape[0]):
        re[j], im[j] = real(plane[j]), imaginary(plane[j])


def there(re, im, scale):
    re, im = np.asarray(re, np.float32), np.asarray(im, np.float32)
    out = np.empty(len(re), np.int32)
    packed_all(re, im, scale, out)
    return out


def back(plane):
    re, im = np.empty(len(plane), np.float32), np.empty(len(plane), np.float32)
    units_of_all(plane, re, im)
    return re, im


@pytest.mark.parametrize("scale", SCALES)
def test_both_parts_are_recovered_within_half_a_unit(scale):
    rng = np.random.default_rng(5)
    most = np.float32(MOST / scale)
    re, im = rng.uniform(-most, most, (2, 20_000)).astype(np.float32)
    found = unpacked(there(re, im, scale), scale)
    assert np.abs(found.real - re).max() <= 0.5001 / scale
    assert np.abs(found.imag - im).max() <= 0.5001 / scale


@settings(deadline=None)  # the first call compiles
@given(st.integers(-MOST, MOST), st.integers(-MOST, MOST))
def test_whole_units_are_recovered_exactly(re, im):
    found = back(there([re / PHASOR_SCALE], [im / PHASOR_SCALE], PHASOR_SCALE))
    assert (found[0][0], found[1][0]) == (re, im)


@pytest.mark.parametrize("scale", SCALES)
def test_values_beyond_the_range_are_limited_with_their_sign(scale):
    large = [MOST / scale + 1, 1e9, 3e38, np.inf]
    re, im = back(there(large + [-x for x in large], [-x for x in large] + large, scale))
    assert re.tolist() == [MOST] * 4 + [-MOST] * 4
    assert im.tolist() == [-MOST] * 4 + [MOST] * 4


def test_the_range_holds_every_phasor_of_an_eight_bit_image():
    assert MOST / PHASOR_SCALE >= 255


@pytest.mark.parametrize("scale", SCALES)
def test_nan_becomes_zero_and_leaves_the_other_part_alone(scale):
    re, im = back(there([np.nan, 1.0, np.nan], [2.0, np.nan, np.nan], scale))
    assert re.tolist() == [0, scale, 0]
    assert im.tolist() == [2 * scale, 0, 0]


def test_rows_and_images_are_unpacked_alike():
    rng = np.random.default_rng(6)
    plane = there(*rng.uniform(-200, 200, (2, 600)), PHASOR_SCALE)
    re, im = back(plane)
    assert (unpacked(plane.reshape(20, 30), PHASOR_SCALE).ravel() * PHASOR_SCALE == re + 1j * im).all()
