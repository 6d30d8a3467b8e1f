"""The sequence of the colour calibration, and the roles of its frames."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import CHANNELS, Fringe, GrayBit, Uniform
from pipeline.pattern.sequence import WHITE_LEVEL, Frame, FrameSequence

Axis = Literal["x", "y"]

SINGLE_MEAN, SINGLE_AMPLITUDE = 127.5, 118.0
"""Light of a fringe in one colour: that of the colour fringe, and alone it clips no better than that one."""


def color_sequence(
    size: tuple[int, int],
    *,
    levels: int = 17,
    period_px: float = 32.0,
    steps: int = 4,
    lateral_chromatic: bool = True,
    check: ColorFringe | None = None,
) -> FrameSequence:
    """Black, even levels of each colour, white, fringes of one colour at a time, and a check.

    Four steps: the fundamental of a fringe whose response is not corrected yet is free of the second harmonic.

    Args:
        size: (width, height) of the projector, pixels.
        levels: drive values per colour, black among them.
        period_px: of the fringes of one colour, projector pixels.
        steps: of these fringes, at least 3.
        lateral_chromatic: fringes in y too, and one period of the colour fringe both ways, which gives the order;
            without them lateral chromatic aberration is not measured.
        check: a measuring fringe whose phase error is to be reported; None = none.
    """
    if not 3 <= levels <= 64:
        raise PatternError(f"levels is {levels}, expected 3 to 64 drive values per colour")
    if not 3 <= steps <= 16:
        raise PatternError(f"steps is {steps}, expected 3 to 16")
    frames: list[Frame] = [Uniform(size, (0, 0, 0)), Uniform(size, (WHITE_LEVEL,) * 3)]
    for k in range(3):
        for level in np.rint(np.linspace(0, 255, levels)).astype(int)[1:]:
            red, green, blue = (int(level) if c == k else 0 for c in range(3))
            frames.append(Uniform(size, (red, green, blue)))
    axes: tuple[Axis, ...] = ("x", "y") if lateral_chromatic else ("x",)
    for axis, length in zip(axes, size, strict=False):
        for name in CHANNELS:
            frames += steps_of(size, length / period_px, axis, steps, (name,))
        if lateral_chromatic:
            frames.append(ColorFringe(size, 1.0, axis))
    if check is not None:
        frames += check_frames(check)
    return FrameSequence("color", tuple(frames))


def check_frames(pattern: ColorFringe, *, steps: int = 8) -> list[Frame]:
    """A colour fringe and its green channel alone in several steps, the reference for its phase."""
    shift = pattern.shifts[1]
    grey = steps_of(pattern.size, pattern.periods, pattern.axis, steps, ("green",), shift)
    return [pattern, *grey]


def steps_of(
    size: tuple[int, int], periods: float, axis: Axis, steps: int, channels: tuple[str, ...], first: float = 0.0
) -> list[Frame]:
    """A fringe of the given channels, shifted by whole parts of a turn."""
    return [
        Fringe(size, periods, axis, first + 2 * np.pi * n / steps, SINGLE_MEAN, SINGLE_AMPLITUDE, channels)
        for n in range(steps)
    ]


@dataclass(frozen=True, slots=True)
class FringeSet:
    """The steps of one fringe: numbers of the frames and their shifts."""

    frame: Fringe
    indices: tuple[int, ...]
    shifts: tuple[float, ...]


@dataclass(frozen=True, slots=True)
class Roles:
    """The roles of a sequence's frames.

    Args:
        black: dark frames; white: (frame, drive value) of those with three equal channels.
        levels: per colour, (drive value, frame) of the even images of that colour alone.
        single: steps of the fringes of one colour, for each of ``axes`` in the order red, green, blue.
        coarse: frame of the one-period colour fringe along an axis.
        check_fringes: colour fringes with their reference.
    """

    black: tuple[int, ...]
    white: tuple[tuple[int, int], ...]
    levels: tuple[tuple[tuple[int, int], ...], ...]
    single: dict[Axis, tuple[FringeSet, FringeSet, FringeSet]]
    coarse: dict[Axis, int]
    check_fringes: tuple[tuple[int, FringeSet], ...]


def roles_of(sequence: FrameSequence) -> Roles:
    """Sort the frames of a sequence; PatternError if one for the colour calibration is missing."""
    black: list[int] = []
    white: list[tuple[int, int]] = []
    levels: list[list[tuple[int, int]]] = [[], [], []]
    check_fringes: list[int] = []
    coarse: dict[Axis, int] = {}
    groups: dict[tuple[tuple[str, ...], Axis, float, float, float], list[tuple[int, Fringe]]] = {}
    for index, frame in enumerate(sequence.frames):
        if isinstance(frame, Uniform):
            lit = [k for k in range(3) if frame.color[k] > 0]
            if not lit:
                black.append(index)
            elif len(lit) == 1:
                levels[lit[0]].append((frame.color[lit[0]], index))
            elif len(set(frame.color)) == 1:
                white.append((index, frame.color[0]))
        elif isinstance(frame, Fringe):
            key = (frame.channels, frame.axis, frame.periods, frame.mean, frame.amplitude)
            groups.setdefault(key, []).append((index, frame))
        elif isinstance(frame, GrayBit):
            continue  # It carries no colour information.
        elif frame.profile is None and frame.periods <= 1.5:
            coarse[frame.axis] = index
        else:
            check_fringes.append(index)
    sets = [_set(members) for members in groups.values() if len(members) >= 3]
    if not black:
        raise PatternError("the sequence has no black frame; a calibration of colour needs one (uniform, 0 0 0)")
    for name, found in zip(CHANNELS, levels, strict=True):
        found.sort()
        if len(found) < 2 or found[-1][0] != 255:
            raise PatternError(
                f"the sequence has {len(found)} even frames of {name} alone, expected at least 2, one of them 255"
            )
    single = _single(sets)
    if not single:
        raise PatternError("the sequence has no fringes of red, of green and of blue alone, at least 3 steps of each")
    return Roles(
        tuple(black), tuple(white), tuple(tuple(found) for found in levels), single, coarse,
        tuple(_with_reference(sequence, check_fringes, sets)),
    )  # fmt: skip


def _set(members: list[tuple[int, Fringe]]) -> FringeSet:
    return FringeSet(members[0][1], tuple(i for i, _ in members), tuple(f.shift for _, f in members))


def _single(sets: list[FringeSet]) -> dict[Axis, tuple[FringeSet, FringeSet, FringeSet]]:
    """Per axis the fringe that all three colours were shown in alone."""
    found: dict[Axis, tuple[FringeSet, FringeSet, FringeSet]] = {}
    for axis in ("x", "y"):
        for red in sets:
            same = [
                next((s for s in sets if s.frame.channels == (name,) and s.frame.axis == axis
                      and s.frame.periods == red.frame.periods), None)
                for name in CHANNELS
            ]  # fmt: skip
            if red.frame.channels == ("red",) and same[0] and same[1] and same[2]:
                found[axis] = (same[0], same[1], same[2])
    return found


def _with_reference(
    sequence: FrameSequence, check_fringes: list[int], sets: list[FringeSet]
) -> list[tuple[int, FringeSet]]:
    out = []
    for index in check_fringes:
        frame = sequence.frames[index]
        for s in sets:
            if (
                isinstance(frame, ColorFringe)
                and frame.profile is None
                and s.frame.channels == ("green",)
                and (s.frame.axis, s.frame.periods) == (frame.axis, frame.periods)
                and len(s.indices) >= 5
            ):
                out.append((index, s))
    return out
