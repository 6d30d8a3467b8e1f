"""The colour sequence, and the roles of frames in any sequence."""

import numpy as np
import pytest

from pipeline.calibrate.color.color_sequence import color_sequence, roles_of
from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import Uniform
from pipeline.pattern.sequence import FrameSequence, from_mapping

SIZE = (256, 200)


def test_every_frame_has_its_role_also_when_read_from_a_file():
    pattern = ColorFringe(SIZE, 20)
    sequence = color_sequence(SIZE, check=pattern)
    roles = roles_of(from_mapping(sequence.as_mapping()))
    assert len(sequence) == 1 + 1 + 3 * 16 + 2 * (3 * 4 + 1) + 9
    assert len(roles.black) == len(roles.white) == 1
    assert [len(found) for found in roles.levels] == [16] * 3
    assert set(roles.single) == set(roles.coarse) == {"x", "y"}
    for sets in roles.single.values():
        assert [s.frame.channels for s in sets] == [("red",), ("green",), ("blue",)]
        assert all(len(s.indices) == 4 for s in sets)
    ((index, reference),) = roles.check_fringes
    assert sequence.frames[index] == pattern or sequence.frames[index].periods == 20
    assert len(reference.indices) == 8


def test_without_lateral_chromatic_aberration_there_are_fringes_in_x_only():
    roles = roles_of(color_sequence(SIZE, levels=5, lateral_chromatic=False))
    assert set(roles.single) == {"x"}
    assert not roles.coarse


def test_every_colour_goes_from_dark_to_full():
    roles = roles_of(color_sequence(SIZE, levels=5))
    assert [level for level, _ in roles.levels[2]] == [64, 128, 191, 255]


@pytest.mark.parametrize(
    ("kept", "message"),
    [
        (lambda f: not (isinstance(f, Uniform) and f.color == (0, 0, 0)), "no black frame"),
        (lambda f: not (isinstance(f, Uniform) and f.color == (0, 0, 255)), "even frames of blue alone"),
        (lambda f: isinstance(f, Uniform), "no fringes of red, of green and of blue alone"),
    ],
)
def test_what_is_missing_in_a_sequence_is_named(kept, message):
    frames = tuple(f for f in color_sequence(SIZE, levels=5).frames if kept(f))
    with pytest.raises(PatternError, match=message):
        roles_of(FrameSequence("color", frames))


@pytest.mark.parametrize("options", [{"levels": 2}, {"levels": 65}, {"steps": 2}])
def test_sizes_of_the_sequence_are_bounded(options):
    with pytest.raises(PatternError, match="expected 3 to"):
        color_sequence(SIZE, **options)


def test_images_of_one_colour_are_dark_in_the_others():
    for frame in color_sequence(SIZE, levels=3).frames:
        if getattr(frame, "channels", None) == ("red",):
            assert not np.asarray(frame.image())[..., 1:].any()
