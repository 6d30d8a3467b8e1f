"""The three-chip decoder against the same steps in whole planes and double precision."""

import cv2
import numpy as np
import pytest

from pipeline.decode.kernels.color_gains import CHANGE, LAG, MILD, STRONG
from pipeline.decode.packed_phasor import PHASOR_SCALE, unpacked
from tests.pipeline.decode.images import (
    SHIFTS,
    decoder,
    hard_image,
    levels_of,
    local_means_of,
    phasors_of,
    phasors_rows,
    wrapped,
)
from tests.pipeline.rigs import CROSSTALK

ROUNDED = 0.75
"""Units by which rounding both parts may move a phasor: half the diagonal of a unit, and a little."""


def gains_of(channels):
    means = local_means_of(channels)
    size = abs(means @ np.exp(1j * np.array(SHIFTS))) / (means.sum(axis=2) / 2)
    share = np.clip((size**2 - MILD**2) / (STRONG**2 - MILD**2), 0, 1)[..., None]
    return 1 + share * (means.mean(axis=2, keepdims=True) / means - 1)


def neighbours(a, axis):
    return np.roll(a, 1, axis), np.roll(a, -1, axis)


def folded(sums, unit, axis, nominal, weight):
    """One direction of the window fit in whole planes; at the image's end the pixel alone."""
    back, ahead = neighbours(unit, axis)
    f, b = ahead * unit.conj(), unit * back.conj()
    agreement = (f * b.conj()).real
    forward = (f * np.conj(nominal)).real >= (b * np.conj(nominal)).real
    step = np.where(agreement > 0.85, (f + b) / np.maximum(abs(f + b), 1e-3), np.where(forward, f, b))
    both = agreement >= 0.1
    use_back, use_ahead = weight * (both | ~forward), weight * (both | forward)
    out = []
    for a, turn, power in zip(sums, (1, step, 1, 1), (1, 1, 1, 2), strict=True):
        before, after = neighbours(a, axis)
        total = a + use_back**power * before * turn + use_ahead**power * after * np.conj(turn)
        ends = np.moveaxis(total, axis, 0), np.moveaxis(a, axis, 0)
        ends[0][[0, -1]] = ends[1][[0, -1]]
        out.append(total)
    return out


@pytest.mark.parametrize("radius", [0, 1])
def test_the_three_chip_decoder_does_what_whole_planes_in_double_precision_do(radius):
    raw = hard_image()
    levels = levels_of(raw)
    unmixed = levels @ np.linalg.inv(CROSSTALK).T
    gains = gains_of(unmixed)
    phasor, mean = phasors_of(unmixed * gains, np.eye(3))
    unit = phasor / np.maximum(abs(phasor), 1e-6)
    clear = (raw < 254).all(axis=2)
    solution = phasors_rows()
    tangent = (solution[2] * unit.real[..., None] - solution[1] * unit.imag[..., None]) * gains
    spread = ((tangent @ np.linalg.inv(CROSSTALK)) ** 2 * (4.0 + 0.1 * np.maximum(levels, 0))).sum(axis=2)
    change = np.zeros(gains.shape)
    change[:, LAG:-LAG] = (gains[:, 2 * LAG :] - gains[:, : -2 * LAG]) / gains[:, LAG:-LAG]
    spread += CHANGE * (change**2).sum(axis=2) * abs(phasor) ** 2
    sums = [clear * 1.0, clear * phasor, clear * mean, clear * spread]
    weight = np.exp(-0.5) if radius else 0.0
    for axis, nominal in ((1, np.exp(2j * np.pi / 11)), (0, 1.0)):
        sums = folded(sums, unit, axis, nominal, weight)
    found = decoder(window_radius=radius, read_noise=2.0, noise_gain=0.1).decode(raw)
    here = clear & (abs(phasor) > 1)
    w, c, a, v = (s[here] for s in sums)
    plain = ((gains == 1) & (change == 0)).all(axis=2).astype(np.uint8)
    plain = cv2.erode(plain, np.ones((3, 3)))[here] != 0
    assert 0.9 < plain.mean() < 1

    # A sample in a thousand lies on the border of a decision, where rounding decides. Gains are those of rounded means.
    def agree(x, y, tolerance):
        different = abs(x - y)
        assert np.mean(different[plain] > tolerance) < 1e-3
        assert np.mean(different[~plain] > max(20 * tolerance, 0.02)) < 0.05

    phasors = unpacked(found.phasor, PHASOR_SCALE)
    agree(phasors[here], c / w, 1e-2)
    agree(wrapped(found.phase[here] - np.angle(c)), 0, 1e-4)
    agree(found.mean[here], np.minimum(a / w, 255), 0.51)
    agree(found.variance[here] * abs(c) ** 2 / v, 1, 1e-3)
    agree(found.modulation[here], np.minimum(abs(c / w), 255), 1.01)
    clearly = here & (abs(abs(phasors) - 5) > ROUNDED / PHASOR_SCALE)
    assert np.array_equal(found.valid[clearly], ((abs(phasors) >= 5) & (found.variance < 1))[clearly])
    assert (np.abs(wrapped(found.phase - np.angle(phasors))) * abs(phasors))[here].max() < ROUNDED / PHASOR_SCALE
    assert found.saturated == pytest.approx(1 - clear.mean(), abs=1e-6)
