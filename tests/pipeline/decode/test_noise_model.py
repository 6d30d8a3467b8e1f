"""The noise model that is estimated from an image."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.decode.noise_model import estimate

FLOOR, GAIN = 0.64 + 1 / 12, 0.0255


def _image(exposure: float) -> np.ndarray:
    """Vertical fringes of a three-chip camera with known noise, cut off at 255 counts."""
    rng = np.random.default_rng(5)
    phase = 0.6 * np.arange(1024)[:, None] + np.array([0.0, 2.1, 4.2])
    light = exposure * np.linspace(40, 120, 820)[:, None, None] * (1.05 + np.cos(phase)) + 4
    return np.clip(np.rint(light + rng.normal(0, 1, light.shape) * np.sqrt(0.64 + GAIN * light)), 0, 255).astype(
        np.uint8
    )


@pytest.mark.parametrize("exposure", [1.0, 1.6, 2.4])
def test_saturated_samples_do_not_make_the_noise_smaller(exposure: float) -> None:
    found = estimate(_image(exposure), along=0, step=1)
    assert found.gain == pytest.approx(GAIN, rel=0.1)
    assert found.floor == pytest.approx(FLOOR, abs=0.35)
