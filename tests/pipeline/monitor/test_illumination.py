"""Clipped samples and fringe amplitude come out as they were drawn, for every encoding and both axes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pipeline.decode.raw_image import BAYER
from pipeline.monitor.illumination import measure_illumination

WIDTH, HEIGHT, PERIOD = 512, 400, 16.7
AMPLITUDE = (20.0, 35.0, 50.0)


def fringes(amplitude: tuple[float, ...] = AMPLITUDE, *, period: float = PERIOD, axis: str = "x") -> Any:
    """(H, W, 3) of colour fringes on a shaded surface."""
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    along = u if axis == "x" else v
    mean = 110 + 20 * np.sin(u / 90) + 10 * np.cos(v / 70)
    noise = np.random.default_rng(0).normal(0, 1, (HEIGHT, WIDTH, 3))
    waves = [b * np.cos(2 * np.pi * (along / period + c / 3) + v / 50) for c, b in enumerate(amplitude)]
    return np.clip(np.round(mean[..., None] + np.stack(waves, -1) + noise), 0, 255).astype(np.uint8)


def mosaic(image: Any, encoding: str) -> Any:
    raw = np.zeros(image.shape[:2], np.uint8)
    for down in (0, 1):
        for across in (0, 1):
            raw[down::2, across::2] = image[down::2, across::2, BAYER[encoding][down][across]]
    return raw


def lit(value: int = 40, stride: int = 1) -> Any:
    return np.full((-(-HEIGHT // stride), -(-WIDTH // stride)), value, np.uint8)


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("encoding", ["rgb8", *BAYER])
def test_the_amplitude_of_every_channel_is_found(encoding: str, axis: str) -> None:
    image = fringes(axis=axis)
    raw = image if encoding == "rgb8" else mosaic(image, encoding)
    seen = measure_illumination(raw, encoding, lit(), period_px=PERIOD, axis=axis)
    assert seen.saturated == (0.0, 0.0, 0.0)
    assert seen.amplitude == pytest.approx(AMPLITUDE, rel=0.1)


@pytest.mark.parametrize("wrong", [0.85, 1.15])
def test_a_period_that_is_not_quite_right_hardly_matters(wrong: float) -> None:
    seen = measure_illumination(fringes(), "rgb8", lit(), period_px=wrong * PERIOD)
    assert seen.amplitude == pytest.approx(AMPLITUDE, rel=0.15)


def test_a_surface_without_fringes_has_hardly_any_amplitude() -> None:
    seen = measure_illumination(fringes((0.0, 0.0, 0.0)), "rgb8", lit(), period_px=PERIOD)
    assert max(seen.amplitude) < 5


def test_saturated_samples_are_counted_by_channel() -> None:
    image = fringes()
    image[:, : WIDTH // 4, 1] = 255
    assert measure_illumination(image, "rgb8", lit(), period_px=PERIOD).saturated == pytest.approx((0, 0.25, 0))


def test_without_light_there_is_no_amplitude() -> None:
    seen = measure_illumination(fringes(), "rgb8", lit(0), period_px=PERIOD)
    assert all(math.isnan(value) for value in seen.amplitude)


def test_subsampled_and_monochrome_images_are_measured() -> None:
    assert measure_illumination(
        fringes(), "rgb8", lit(stride=2), period_px=PERIOD, stride=2
    ).amplitude == pytest.approx(AMPLITUDE, rel=0.1)
    gray = fringes()[..., 2]
    assert measure_illumination(gray, "mono8", lit(), period_px=PERIOD).amplitude == pytest.approx((50.0,), rel=0.1)
    deep = gray.astype(np.uint16) * 257
    assert measure_illumination(deep, "mono16", lit(), period_px=PERIOD).amplitude == pytest.approx((50.0,), rel=0.1)


def test_an_image_of_a_few_pixels_is_no_error() -> None:
    for size in ((2, 3), (5, 40)):
        image = np.zeros((*size, 3), np.uint8)
        assert len(measure_illumination(image, "rgb8", image[..., 0], period_px=PERIOD).amplitude) == 3
