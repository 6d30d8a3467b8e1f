"""The Cramer-Rao bound against repeated measurements, pixel by pixel."""

from __future__ import annotations

import numpy as np

from pipeline.rig.calibration import ColorModel
from sim.evaluate.cramer_rao import depth_bound_mm, phase_variance
from sim.render.render_pair import render_pair
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build

LAYOUT = RigLayout().scaled(0.125)
FRINGE = LAYOUT.pattern(12.0)


def test_three_samples_of_a_pixel_reach_the_bound_of_its_phase() -> None:
    rng = np.random.default_rng(7)
    color = ColorModel(np.full(3, 4.0), np.array([[1, 0.1, 0.03], [0.08, 1, 0.1], [0.02, 0.12, 1]]))
    optics = Optics(read_noise_dn=1.5)
    phase = rng.uniform(-np.pi, np.pi, 64)
    light = 110 + 60 * np.cos(phase[:, None] + np.array(FRINGE.shifts))
    expected = light @ color.mix.T
    noise = rng.standard_normal((20_000, 64, 3)) * np.sqrt(expected * 255 / optics.full_well_e + 1.5**2)
    counts = np.rint(expected + noise) / 1.0
    phasor = (counts @ color.unmix.T) @ np.exp(-1j * np.array(FRINGE.shifts))
    measured = np.angle(phasor * np.exp(-1j * phase)).var(axis=0)
    image = np.rint(expected + 4).astype(np.uint8)[None]
    assert np.allclose(phase_variance(image, color, FRINGE, optics)[0], measured, rtol=0.06)


def test_saturated_pixels_have_no_bound() -> None:
    image = np.full((1, 2, 3), 120, np.uint8)
    image[0, 1, 2] = 254
    assert np.isnan(phase_variance(image, ColorModel(), FRINGE, Optics())).tolist() == [[False, True]]


def test_the_bound_grows_with_the_noise_and_with_the_fringes_period() -> None:
    def bound(optics: Optics, periods: float = 12.0) -> float:
        fringe = LAYOUT.pattern(periods)
        pair = render_pair(LAYOUT, build("plane", seed=0), fringe, optics)
        calibration = LAYOUT.calibration_for(optics)
        return float(np.nanmedian(depth_bound_mm(pair.left, pair.right, pair.truth_left, calibration, fringe, optics)))

    plain = bound(Optics(read_noise_dn=0.0))
    # Rounding adds 1/12 to a variance of about 3.
    assert np.isclose(bound(Optics(read_noise_dn=0.0, noise=4.0)), 4 * plain, rtol=0.03)
    assert np.isclose(bound(Optics(read_noise_dn=0.0), 6.0), 2 * plain, rtol=0.08)
