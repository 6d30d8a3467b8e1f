"""Absolute phase from several fringes: exact without noise, certain or unknown with it, for any light and gain."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.calibrate.projector.absolute_phase import coordinate, evenly_lit, gray, levels
from pipeline.common.errors import ImageError, PatternError
from pipeline.decode.noise_model import NoiseModel
from pipeline.decode.raw_image import BAYER, mosaic_of
from pipeline.multi_frame.n_step import absolute_phase, noise_of, unwrapped, wrapped_phase
from pipeline.pattern.projected_frames import Fringe, Uniform
from pipeline.pattern.sequence import FrameSequence, projector_sequence

SIZE = (640, 96)
SEQUENCE = projector_sequence(SIZE)


def _columns(n: int = 4000, seed: int = 3) -> NDArray[np.float64]:
    """Positions all over the image, (n,), also within the first and the last column."""
    rng = np.random.default_rng(seed)
    return np.concatenate([[-0.4, 0.0, SIZE[0] - 1.0, SIZE[0] - 0.6], rng.uniform(-0.45, SIZE[0] - 0.55, n - 4)])


def _light(frame: Fringe, at: NDArray[np.float64]) -> NDArray[np.float64]:
    return frame.mean + frame.amplitude * np.cos(2 * np.pi * frame.periods * (at + 0.5) / frame.length + frame.shift)


def _sets(at: NDArray[np.float64], gain: float = 0.7, ambient: float = 9.0, sigma: float = 0.0, seed: int = 0):
    """Phases of the sequence's fringes along x at these positions, and the numbers of periods."""
    rng = np.random.default_rng(seed)
    found = levels(SEQUENCE, "x")
    sets = []
    for level in found:
        frames = [SEQUENCE.frames[n] for n in level.frames]
        planes = [gain * _light(f, at)[None] + ambient + sigma * rng.standard_normal((1, len(at))) for f in frames]
        sets.append(wrapped_phase(planes, level.shifts))
    return sets, [level.periods for level in found]


def _images(at: NDArray[np.float64], *, gamma: float = 1.0, noise: float = 0.0, seed: int = 0) -> list[NDArray]:
    """Grey counts (rows, n) of all frames at projector column ``at``, row 40 + row of the image."""
    rng = np.random.default_rng(seed)
    rows = 40.3 + np.arange(6.0)
    out = []
    for frame in SEQUENCE.frames:
        if isinstance(frame, Uniform):
            light = np.full((6, len(at)), float(frame.color[0]))
        else:
            light = np.broadcast_to(
                _light(frame, at)[None] if frame.axis == "x" else _light(frame, rows)[:, None], (6, len(at))
            )
        counts = 200 * (light / 255) ** gamma + 5
        out.append(counts + noise * rng.standard_normal(counts.shape))
    return out


def test_the_phase_of_synthetic_fringes_is_exact_for_any_shifts() -> None:
    true = np.linspace(-3.1, 3.1, 601)
    rng = np.random.default_rng(1)
    for n in (3, 4, 5, 8, 13):
        shifts = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n + rng.uniform(-0.3, 0.3, n)
        got = wrapped_phase([100 + 60 * np.cos(true + s)[None] for s in shifts], shifts)
        np.testing.assert_allclose(got.phase[0], true, atol=1e-12)
        np.testing.assert_allclose(got.amplitude, 60, atol=1e-10)
        np.testing.assert_allclose(got.mean, 100, atol=1e-10)


def test_the_absolute_phase_is_exact_for_any_gain_and_ambient_light() -> None:
    at = _columns()
    for gain, ambient in ((0.7, 9.0), (0.2, 0.0), (0.9, 60.0)):
        sets, periods = _sets(at, gain, ambient)
        phase = absolute_phase(sets, periods, NoiseModel(1e-6, 0.0))
        np.testing.assert_allclose(phase[0] * SIZE[0] / (2 * np.pi * periods[-1]) - 0.5, at, atol=1e-9)


def test_the_scatter_of_the_phase_agrees_with_its_sigma() -> None:
    at = _columns(20000)
    sets, _ = _sets(at, sigma=2.0)
    for one, clean in zip(sets, _sets(at)[0], strict=True):
        error = np.angle(np.exp(1j * (one.phase - clean.phase)))
        assert (error / one.sigma(NoiseModel(4.0, 0.0))).std() == pytest.approx(1.0, abs=0.02)


def test_shot_noise_counts_at_the_brightness_of_each_image() -> None:
    true = np.repeat(np.linspace(-3, 3, 9), 20000)
    rng = np.random.default_rng(5)
    shifts = 2 * np.pi * np.arange(3) / 3
    clean = [80 + 70 * np.cos(true + s)[None] for s in shifts]
    noisy = [plane + np.sqrt(0.05 * plane) * rng.standard_normal(plane.shape) for plane in clean]
    got = wrapped_phase(noisy, shifts)
    ratio = (got.phase[0] - true) / got.sigma(NoiseModel(0.0, 0.05))[0]
    # Three steps are noisy at some phases and quiet at others.
    np.testing.assert_allclose(ratio.reshape(9, -1).std(axis=1), 1.0, atol=0.03)


def test_noise_is_estimated_from_the_difference_of_two_sets_means() -> None:
    at = np.tile(_columns(4000), 10)
    images = _images(at, gamma=2.2)
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.2, 1.2, len(at))
    sets = []
    for axis in ("x", "y"):
        level = levels(SEQUENCE, axis)[-1]
        planes = [albedo * images[n] for n in level.frames]
        noisy = [plane + np.sqrt(0.6 + 0.025 * plane) * rng.standard_normal(plane.shape) for plane in planes]
        sets.append(wrapped_phase(noisy, level.shifts))
    noise = noise_of(sets)
    assert noise.floor == pytest.approx(0.6, abs=0.1)
    assert noise.gain == pytest.approx(0.025, rel=0.1)


def test_unwrapping_is_right_or_unknown_at_any_noise() -> None:
    at = _columns(40000)
    known = []
    for sigma in (1.0, 4.0, 12.0, 30.0):
        sets, periods = _sets(at, gain=0.5, sigma=sigma)
        phase = absolute_phase(sets, periods, NoiseModel(sigma**2, 0.0))[0]
        error = phase - 2 * np.pi * periods[-1] * (at + 0.5) / SIZE[0]
        good = np.isfinite(phase)
        known.append(good.mean())
        assert (np.abs(error[good]) > np.pi).sum() <= 1e-4 * good.sum()
    assert known[0] > 0.999
    assert known[1] > 0.99
    assert known[-1] < 0.2


def test_a_pixel_between_two_periods_is_left_unknown() -> None:
    coarse, ratio = np.array([1.0, 1.0]), 8.0
    phase = np.array([8.0 - 2 * np.pi, 8.0 + np.pi - 0.05 - 2 * np.pi])
    got = unwrapped(coarse, np.full(2, 0.01), phase, np.full(2, 0.02), ratio)
    assert got[0] == pytest.approx(8.0)
    assert np.isnan(got[1])


def test_a_nonlinear_response_does_not_move_the_fine_phase() -> None:
    at = _columns()
    got = coordinate([np.rint(p).astype(np.uint8) for p in _images(at)], SEQUENCE, "x", encoding="mono8")
    bent = coordinate([(257 * p).astype(np.uint16) for p in _images(at, gamma=2.2)], SEQUENCE, "x", encoding="mono16")
    assert bent.valid.mean() > 0.999
    assert np.nanstd(got.px - at) < 0.02
    assert np.nanmax(np.abs(bent.px - at)) < 0.003


@pytest.mark.parametrize("encoding", ["rgb8", *BAYER, "mono8", "mono16"])
def test_every_encoding_gives_both_coordinates(encoding: str) -> None:
    at = _columns(400)
    rng = np.random.default_rng(0)
    tint = np.array([0.8, 1.0, 0.6])
    raw = []
    for counts in _images(at, noise=0.5):
        colored = counts[..., None] * tint
        if encoding == "mono16":
            raw.append(np.rint(counts * 257).astype(np.uint16))
            continue
        if encoding == "mono8":
            colored = counts
        elif encoding != "rgb8":
            channel = mosaic_of(encoding)
            assert channel is not None
            rows, columns = np.mgrid[0:6, 0 : len(at)]
            colored = np.take_along_axis(colored, channel[rows % 2, columns % 2][..., None], axis=2)[..., 0]
        raw.append(np.rint(colored + 0.1 * rng.standard_normal(colored.shape)).astype(np.uint8))
    x = coordinate(raw, SEQUENCE, "x", encoding=encoding)
    y = coordinate(raw, SEQUENCE, "y", encoding=encoding)
    assert x.valid.mean() > 0.99
    assert np.nanstd(x.px - at) < 0.06
    assert np.nanstd(y.px - 40.3 - np.arange(6.0)[:, None]) < 0.06


def test_crosstalk_does_not_change_grey_fringes() -> None:
    at = _columns(600)
    mix = np.eye(3) + 0.12 * np.array([[0, 0.9, 0.3], [1.0, 0, 0.8], [0.2, 1.1, 0]])
    images = [0.6 * p for p in _images(at)]
    mixed = [np.rint(np.repeat(p[..., None], 3, axis=2) @ mix.T).astype(np.uint8) for p in images]
    assert np.nanstd(coordinate(mixed, SEQUENCE, "x").px - at) < 0.02


def test_saturated_and_dark_pixels_are_unknown() -> None:
    at = _columns(400)
    images = [np.rint(p).astype(np.uint8) for p in _images(at)]
    bright = [p.copy() for p in images]
    for p in bright:
        p[2] = np.minimum(p[2] * 1.9, 255)
        p[3] = p[3] // 40
    got = coordinate(bright, SEQUENCE, "y", encoding="mono8")
    assert got.valid[[0, 1, 4, 5]].all()
    assert not got.valid[[3]].any()
    saturated = np.stack([p[2] >= 254 for p in bright[-6:]]).any(axis=0)
    assert saturated.any()
    assert not got.valid[2, saturated].any()


def test_an_evenly_lit_image_is_computed_from_the_same_images() -> None:
    at = _columns(500)
    shade = np.linspace(0.3, 1.0, 500)
    images = [np.rint(257 * shade * p).astype(np.uint16) for p in _images(at, gamma=2.2)]
    flat = evenly_lit(images, SEQUENCE) / (257 * shade)
    assert flat.shape == (6, 500)
    assert flat.std() < 0.02
    with pytest.raises(ImageError, match="no evenly lit image"):
        evenly_lit(images[:3], SEQUENCE)


def test_only_the_fringes_of_the_chosen_channels_count() -> None:
    red = tuple(replace(f, channels=("red",)) for f in SEQUENCE.frames if isinstance(f, Fringe) and f.axis == "x")
    both = FrameSequence("both", (*SEQUENCE.frames, *red))
    assert [level.frames for level in levels(both, "x")] == [level.frames for level in levels(SEQUENCE, "x")]
    assert [level.frames[0] for level in levels(both, "x", lit=("red",))] == [28, 31, 35]


def test_images_that_cannot_be_decoded_are_refused_with_the_reason() -> None:
    with pytest.raises(PatternError, match="at least 3"):
        wrapped_phase([np.zeros((2, 2))] * 2, [0.0, 1.0])
    with pytest.raises(PatternError, match="do not separate"):
        wrapped_phase([np.zeros((2, 2))] * 3, [0.0, 0.0, 1.0])
    fine = wrapped_phase([np.zeros((2, 2))] * 3, [0.0, 2.0, 4.0])
    with pytest.raises(PatternError, match="at most 1"):
        absolute_phase([fine], [8.0], NoiseModel(1.0, 0.0))
    with pytest.raises(ImageError, match="one each"):
        coordinate([], SEQUENCE, "x")
    with pytest.raises(ImageError, match="rgb8 is"):
        gray(np.zeros((4, 4), np.uint8), "rgb8")
    with pytest.raises(ImageError, match="not known"):
        gray(np.zeros((4, 4), np.uint8), "yuv")
    with pytest.raises(PatternError, match="no three shifts"):
        coordinate([np.zeros((4, 4, 3), np.uint8)], FrameSequence("white", (Uniform(SIZE, (255, 255, 255)),)), "x")
