"""The sets of the modes: what they hold, that JSON keeps them, and that codes number columns."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.common.errors import PatternError
from pipeline.multi_frame.image_roles import plan_of
from pipeline.pattern.mode_sequences import MODES, heterodyne_periods, mode_sequence
from pipeline.pattern.projected_frames import Fringe, GrayBit, Uniform
from pipeline.pattern.sequence import FrameSequence, frame_from_mapping, from_mapping
from pipeline.rig.calibration import Response

SIZE = (1280, 1024)


@given(
    st.sampled_from(MODES), st.floats(4, 200), st.integers(3, 16), st.sampled_from(["x", "y"]),
)  # fmt: skip
def test_every_set_can_be_read_and_survives_json(mode, periods, steps, axis):
    made = mode_sequence(mode, SIZE, periods=periods, steps=steps, axis=axis)
    again = from_mapping(json.loads(json.dumps(made.as_mapping())))
    assert again.as_mapping() == made.as_mapping()
    plan = plan_of(again)
    assert (plan.kind, plan.periods, plan.axis, plan.frames) == (mode, periods, axis, len(made))
    assert 0 <= plan.centre <= len(made) - 1


@given(st.floats(4, 400))
def test_beats_of_the_three_fringes_have_one_common_period(finest):
    a, b, c = heterodyne_periods(finest)
    assert a > b > c > 0
    assert (a - b) - (b - c) == pytest.approx(1)


@given(st.integers(1, 10), st.floats(0, 1), st.booleans())
def test_gray_bits_number_the_cells(bits, share, inverted):
    cells = 1 + share * (min(2**bits, 300) - 1)
    shown = [GrayBit((300, 4), k, bits, inverted, "x", cells).ones ^ inverted for k in range(bits)]
    code = np.zeros(300, int)
    for ones in shown:
        code = 2 * code + ones
    number, shift = code.copy(), 1
    while shift < bits:
        number ^= number >> shift
        shift *= 2
    assert (number == np.floor(cells * (np.arange(300) + 0.5) / 300)).all()
    # From one cell to the next a single bit changes.
    changes = np.stack(shown).astype(int)
    assert (np.abs(np.diff(changes, axis=1)).sum(axis=0) == np.minimum(np.diff(number), 1)).all()


def test_a_bit_is_two_levels_of_light():
    bit = GrayBit((16, 3), 1, 2, axis="x", channels=("red", "blue"))
    light = bit.light()
    assert light.shape == (3, 16, 3)
    assert set(np.unique(light[..., 0])) == {8.0, 192.0}
    assert not light[..., 1].any()
    response = Response(np.arange(256.0), np.tile((np.arange(256) / 255) ** 2.2, (3, 1)))
    sent = response.light(bit.image(response).astype(float))
    assert np.abs(sent - light).max() < 1.5
    assert (replace(bit, inverted=True).light()[..., 0] == 200 - light[..., 0]).all()
    assert GrayBit((3, 16), 0, 1, axis="y").light()[:8].max() == 8.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"bit": 3}, "pattern.bit is 3"), ({"bits": 14}, "pattern.bits is 14"), ({"bit": 0.5}, "pattern.bit is 0.5"),
        ({"inverted": 1}, "pattern.inverted"), ({"cells": 9}, "pattern.cells is 9"), ({"cells": -1}, "pattern.cells"),
        ({"axis": "z"}, "pattern.axis"), ({"mean": 1}, "pattern.mean"), ({"channels": ["pink"]}, "pattern.channels"),
        ({"size": [0, 4]}, "pattern.size"), ({"bits": None}, "pattern.bits is None, expected a whole number"),
    ],
)  # fmt: skip
def test_a_bad_bit_is_refused_by_its_key(change, word):
    good = GrayBit((64, 48), 1, 3).as_mapping()
    assert frame_from_mapping(good).as_mapping() == good
    with pytest.raises(PatternError, match=word):
        frame_from_mapping(good | change)


def test_a_bit_needs_only_what_the_format_names():
    short = {"kind": "gray", "bit": 0, "bits": 4, "inverted": False, "size": [64, 48], "axis": "x"}
    assert frame_from_mapping(short) == GrayBit((64, 48), 0, 4)


@pytest.mark.parametrize(
    ("name", "options", "word"),
    [
        ("sine", {}, "mode 'sine'"), ("gray", {"periods": 3}, "periods is 3"), ("gray", {"periods": 321}, "periods"),
        ("heterodyne", {"steps": 2}, "steps is 2"),
    ],
)  # fmt: skip
def test_a_bad_mode_is_refused(name, options, word):
    with pytest.raises(PatternError, match=word):
        mode_sequence(name, SIZE, **options)


def test_insufficient_sets_are_rejected():
    gray, fringes = mode_sequence("gray", SIZE), mode_sequence("heterodyne", SIZE)
    color = mode_sequence("two_color", SIZE).frames
    for frames, word in (
        ((Uniform(SIZE, (1, 2, 3)),), "expected one axis"),
        (gray.frames[:4], "orders need a Gray code"),
        (gray.frames[:-1], "not one whole code"),
        (gray.frames[4:], "no fringe"),
        ((*gray.frames, *fringes.frames[:4], *fringes.frames[4:8]), "numbers the periods of one fringe"),
        ((*fringes.frames, color[0]), "two of them and nothing else"),
        ((color[0], color[0]), "both colour fringes have 96"),
        ((*fringes.frames, Fringe(SIZE, 96.0, "y")), "expected one axis"),
        ((replace(fringes.frames[0], mean=120.0), *fringes.frames[1:]), "differ in their light"),
    ):
        with pytest.raises(PatternError, match=word):
            plan_of(FrameSequence("short", frames))
