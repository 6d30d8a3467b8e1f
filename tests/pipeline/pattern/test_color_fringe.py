"""Laws of the pattern: what is projected can be read back, column by column."""

import json

import numpy as np
import pytest

from pipeline.common.errors import PatternError
from pipeline.decode.decoder import design
from pipeline.pattern.color_fringe import ColorFringe, from_mapping, modulated_profile
from pipeline.rig.calibration import ColorModel, Response


def wrapped(a):
    return np.angle(np.exp(1j * a))


def decode(channels, shifts):
    """(A, C, S) of light in three channels."""
    return channels @ np.linalg.inv(design(ColorModel(), shifts)).T


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("profile", [False, True])
@pytest.mark.parametrize("shifts", [(-2 * np.pi / 3, 0.0, 2 * np.pi / 3), (0.1, 1.9, 4.0)])
def test_the_phase_of_every_column_comes_back_from_the_image(axis, profile, shifts):
    length = 1280 if axis == "x" else 1024
    table = modulated_profile(length, 96) if profile else None
    pattern = ColorFringe(axis=axis, shifts=shifts, profile=table)
    line = pattern.light()[0] if axis == "x" else pattern.light()[:, 0]
    mean, c, s = decode(line, shifts).T
    assert np.abs(wrapped(np.arctan2(s, c) - pattern.phase)).max() < 1e-9
    assert np.abs(mean - pattern.mean).max() < 1e-9
    assert np.abs(np.hypot(c, s) - pattern.amplitude).max() < 1e-9
    quantised = pattern.image()[0] if axis == "x" else pattern.image()[:, 0]
    _, c, s = decode(quantised.astype(float), shifts).T
    assert np.abs(wrapped(np.arctan2(s, c) - pattern.phase)).max() < 0.012


def test_the_phase_follows_the_formula_for_120_degrees():
    rng = np.random.default_rng(0)
    red, green, blue = rng.uniform(0, 255, (3, 1000))
    _, c, s = decode(np.stack([red, green, blue], axis=-1), ColorFringe().shifts).T
    expected = np.arctan2(np.sqrt(3) * (red - blue), 2 * green - red - blue)
    assert np.abs(wrapped(np.arctan2(s, c) - expected)).max() < 1e-9


@pytest.mark.parametrize("profile", [None, modulated_profile(1280, 96)])
def test_columns_and_phases_are_each_others_inverse(profile):
    pattern = ColorFringe(profile=profile)
    assert np.abs(pattern.column_of(pattern.phase) - np.arange(1280)).max() < 1e-9
    between = np.interp(np.arange(1279) + 0.3, np.arange(1280), pattern.phase)
    assert np.abs(pattern.column_of(between) - np.arange(1279) - 0.3).max() < 1e-9
    assert np.isnan(pattern.column_of(np.array([-100.0, 1e6]))).all()


def test_a_precorrected_pattern_gives_the_requested_light():
    levels = np.linspace(0, 255, 33)
    curve = (levels / 255) ** 2.2
    response = Response(levels, np.stack([curve, curve**1.1, curve**0.9]))
    pattern = ColorFringe(amplitude=100.0)
    drive = response.drive(pattern.light())
    assert np.abs(response.light(drive) - pattern.light()).max() < 1e-6
    sent = response.light(pattern.image(response).astype(float))
    assert np.abs(sent - pattern.light()).max() < 2.0


def test_a_modulated_profile_rises_and_keeps_its_periods():
    profile = modulated_profile(1280, 96.0, depth=0.15)
    rate = np.diff(profile)
    assert (rate > 0).all()
    assert rate.max() / rate.min() > 1.2
    assert abs(profile[-1] - profile[0] - 2 * np.pi * 96) < 2 * np.pi


@pytest.mark.parametrize("pattern", [ColorFringe(), ColorFringe(axis="y", profile=modulated_profile(1024, 80.5))])
def test_a_pattern_survives_json(pattern):
    again = from_mapping(json.loads(json.dumps(pattern.as_mapping())))
    assert np.array_equal(again.phase, pattern.phase)
    assert again.as_mapping() == pattern.as_mapping()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "stripes"}, "pattern.kind"),
        ({"periods": 0}, "pattern.periods"),
        ({"periods": 900}, "pattern.periods"),
        ({"amplitude": 200}, "amplitude"),
        ({"axis": "z"}, "pattern.axis"),
        ({"shifts": {"red": 0, "green": 0, "blue": 1}}, "different angles"),
        ({"shifts": {"red": 0}}, "green"),
        ({"profile": [1, 2, 3]}, "profile"),
        ({"profile": [0.0] * 1280}, "increasing"),
        ({"size": "big"}, r"pattern.size is 'big', expected width and height"),
        ({"size": [1280]}, r"pattern.size is \[1280\]"),
        ({"shifts": [0, 1, 2]}, r"pattern.shifts is \[0, 1, 2\], expected red, green, blue"),
        ({"periods": None}, "pattern.periods is None, expected a number"),
        ({"mean": []}, r"pattern.mean is \[\]"),
        ({"profile": {"a": 1}}, "pattern.profile is"),
    ],
)
def test_an_invalid_pattern_is_rejected_with_its_key(change, message):
    with pytest.raises(PatternError, match=message):
        from_mapping(ColorFringe().as_mapping() | change)
