"""Sequences of images: round trips, light, and refusals that name the key."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import Fringe, Uniform
from pipeline.pattern.sequence import (
    FrameSequence,
    camera_sequence,
    frame_from_mapping,
    from_mapping,
    projector_sequence,
)
from pipeline.rig.calibration import Response

SIZE = (64, 48)


def test_a_description_gives_the_same_sequence_again() -> None:
    frames = (Uniform(SIZE, (1, 20, 255)), Fringe(SIZE, 3.5, "y", 0.3, 100.0, 60.0, ("blue", "red")))
    sequence = FrameSequence("any", (*frames, ColorFringe(SIZE, 8.0)))
    again = from_mapping(json.loads(json.dumps(sequence.as_mapping())))
    assert again.as_mapping() == sequence.as_mapping()
    assert again.frames[:2] == sequence.frames[:2]
    for a, b in zip(again.frames, sequence.frames, strict=True):
        np.testing.assert_array_equal(a.image(), b.image())


@pytest.mark.parametrize("axis", ["x", "y"])
def test_the_light_of_a_fringe_follows_its_formula_in_the_lit_channels_alone(axis: Any) -> None:
    fringe = Fringe(SIZE, 4.0, axis, 0.7, 110.0, 90.0, ("green",))
    light = fringe.light()
    at = np.arange(fringe.length) + 0.5
    expected = 110 + 90 * np.cos(2 * np.pi * 4 * at / fringe.length + 0.7)
    line = light[5, :, 1] if axis == "x" else light[:, 5, 1]
    np.testing.assert_allclose(line, expected)
    assert not light[..., [0, 2]].any()
    np.testing.assert_array_equal(fringe.image(), np.rint(light).astype(np.uint8))


def test_a_predistorted_fringe_has_the_requested_light() -> None:
    levels = np.arange(256.0)
    response = Response(levels, np.stack([(levels / 255) ** g for g in (2.2, 1.8, 2.4)]))
    fringe = Fringe(SIZE, 4.0, "x", 0.7, 110.0, 90.0, ("red", "blue"))
    image = fringe.image(response)
    assert np.abs(response.light(image.astype(np.float64)) - fringe.light()).max() < 1.2
    assert not image[..., 1].any()


def test_an_even_image_is_sent_as_it_is_described() -> None:
    levels = np.arange(256.0)
    response = Response(levels, np.stack([(levels / 255) ** 2.2] * 3))
    image = Uniform(SIZE, (3, 2, 250)).image(response)
    assert image.shape == (48, 64, 3)
    assert image.dtype == np.uint8
    assert (image == (3, 2, 250)).all()


def test_the_guided_sequences_are_modest_and_cover_both_axes() -> None:
    assert len(camera_sequence((1280, 1024))) == 1
    sequence = projector_sequence((1280, 1024))
    assert len(sequence) == 28
    fringes = [frame for frame in sequence.frames if isinstance(frame, Fringe)]
    assert {(f.axis, f.periods) for f in fringes} == {(a, p) for a in "xy" for p in (1.0, 6.0)} | {
        ("x", 100.0),
        ("y", 80.0),
    }


_GOOD = Fringe(SIZE, 4.0).as_mapping()


@pytest.mark.parametrize(
    ("change", "key"),
    [
        ({"kind": "stripes"}, "kind"),
        ({"size": [64]}, "size is"),
        ({"size": [64, 1e9]}, "size"),
        ({"size": [64, 0]}, "size"),
        ({"size": [64.5, 48]}, "size"),
        ({"periods": 33}, "periods"),
        ({"periods": float("nan")}, "periods"),
        ({"periods": "many"}, "periods is 'many', expected a number"),
        ({"axis": "z"}, "axis"),
        ({"axis": []}, "axis"),
        ({"shift": float("inf")}, "shift"),
        ({"amplitude": 101}, "amplitude"),
        ({"mean": 200}, "mean"),
        ({"channels": []}, "channels"),
        ({"channels": "red"}, "channels"),
        ({"channels": ["red", "red"]}, "channels"),
        ({"channels": ["red", 3]}, "channels"),
    ],
)
def test_a_wrong_frame_is_refused_by_the_name_of_its_key(change: dict[str, Any], key: str) -> None:
    with pytest.raises(PatternError, match=rf"pattern\.frames\[1\].*{key}|pattern\.frames\[1\] {key}"):
        from_mapping({"kind": "sequence", "name": "x", "frames": [_GOOD, _GOOD | change]})


@pytest.mark.parametrize("key", ["size", "periods", "shift", "mean", "amplitude"])
def test_a_missing_key_is_named(key: str) -> None:
    with pytest.raises(PatternError, match=f"{key} is missing"):
        frame_from_mapping({k: v for k, v in _GOOD.items() if k != key})


@pytest.mark.parametrize("color", [[0, 0], [0, 0, 256], [0, -1, 0], [0, 0.5, 0], 7, [0, 0, None]])
def test_a_colour_outside_the_drive_values_is_refused(color: Any) -> None:
    with pytest.raises(PatternError):
        frame_from_mapping({"kind": "uniform", "size": [8, 8], "color": color})


@pytest.mark.parametrize(
    "change",
    [{"frames": []}, {"frames": [_GOOD] * 513}, {"frames": "no"}, {"name": ""}, {"name": "x" * 65}, {"kind": "fringe"}],
)
def test_a_wrong_sequence_is_refused(change: dict[str, Any]) -> None:
    with pytest.raises(PatternError, match=rf"pattern\.{next(iter(change))}"):
        from_mapping({"kind": "sequence", "name": "x", "frames": [_GOOD]} | change)


def test_frames_of_different_sizes_are_refused() -> None:
    with pytest.raises(PatternError, match=r"frames\[1\]\.size"):
        FrameSequence("x", (Uniform((8, 8), (0, 0, 0)), Uniform((8, 9), (0, 0, 0))))
