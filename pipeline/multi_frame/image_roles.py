"""Roles of the images of a set."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from pipeline.common.errors import PatternError
from pipeline.multi_frame.n_step import solution_of
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import Axis, Fringe, GrayBit
from pipeline.pattern.sequence import FrameSequence

F32 = NDArray[np.float32]
Kind = Literal["two_color", "heterodyne", "gray"]
_TURN = 2 * np.pi
_HARMONIC_FROM = 6


@dataclass(frozen=True, slots=True, eq=False)
class Shifted:
    """The images of one fringe, and the linear maps from samples to its phase.

    Args:
        periods: over the projector; frames: numbers of its images in the set.
        solve: (3, n), samples -> mean, C, S.
        rest: (m, n), orthonormal complement of a sinusoid, for n > 5 of its second harmonic too.
        harmonic: second harmonic in the one row of ``rest`` of four steps, complex; 0 for others.
    """

    periods: float
    frames: tuple[int, ...]
    solve: NDArray[np.float64]
    rest: NDArray[np.float64]
    harmonic: complex

    @staticmethod
    def of(periods: float, frames: tuple[int, ...], shifts: NDArray[np.float64]) -> Shifted:
        """For images with these shifts, radians."""
        solve = solution_of(shifts)
        columns = [np.ones_like(shifts), np.cos(shifts), np.sin(shifts)]
        if len(shifts) >= _HARMONIC_FROM:
            columns += [np.cos(2 * shifts), np.sin(2 * shifts)]
        basis, _, _ = np.linalg.svd(np.stack(columns, axis=1))
        rest = basis[:, len(columns) :].T
        harmonic = complex(rest[0] @ np.exp(2j * shifts)) if len(shifts) < _HARMONIC_FROM and len(rest) == 1 else 0j
        return Shifted(periods, frames, solve, rest if len(shifts) != 5 else rest[:0], harmonic)


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Roles of the images of a set, read from its sequence.

    Args:
        kind: source of the orders; size: (width, height) of the projector; axis: along which the phase grows.
        fringes: finest first; empty for colour fringes. bits: (frame, bit); colors: the colour fringes.
    """

    kind: Kind
    size: tuple[int, int]
    axis: Axis
    fringes: tuple[Shifted, ...]
    bits: tuple[tuple[int, GrayBit], ...]
    colors: tuple[ColorFringe, ...]
    frames: int

    @property
    def length(self) -> int:
        """Projector columns (axis x) or rows."""
        return self.size[0] if self.axis == "x" else self.size[1]

    @property
    def periods(self) -> float:
        """Of the finest fringe."""
        return self.fringes[0].periods if self.fringes else self.colors[0].periods

    @property
    def shares(self) -> NDArray[np.float64]:
        """Weights of the fringes in the measured phase, by their noise; their sum is 1."""
        weight = np.array([f.periods**2 * len(f.frames) for f in self.fringes])
        return np.asarray(weight / weight.sum())

    @property
    def centre(self) -> float:
        """Time at which a slowly moving surface is measured, as a (fractional) number of an image."""
        means = [float(np.mean(f.frames)) for f in self.fringes]
        return float(self.shares @ means) if means else 0.0


def plan_of(sequence: FrameSequence) -> Plan:
    """Read a sequence; PatternError names what is missing for a measurement."""
    colors = tuple(frame for frame in sequence.frames if isinstance(frame, ColorFringe))
    if len(colors) == len(sequence) == 2:
        return _two_color(sequence, colors)
    if colors:
        raise PatternError(f"sequence {sequence.name!r}: a set with colour fringes has two of them and nothing else")
    axes = {frame.axis for frame in sequence.frames if isinstance(frame, Fringe | GrayBit)}
    if len(axes) != 1:
        raise PatternError(f"sequence {sequence.name!r} has fringes along {sorted(axes)}, expected one axis")
    axis = axes.pop()
    fringes = _fringes(sequence)
    bits = tuple((n, frame) for n, frame in enumerate(sequence.frames) if isinstance(frame, GrayBit))
    if not fringes:
        raise PatternError(f"sequence {sequence.name!r} has no fringe in three or more steps")
    if bits:
        _check_bits(sequence, bits, fringes)
    elif len(fringes) < 2:
        raise PatternError(f"sequence {sequence.name!r} has one fringe: its orders need a Gray code or a second fringe")
    return Plan("gray" if bits else "heterodyne", sequence.size, axis, fringes, bits, (), len(sequence))


def _two_color(sequence: FrameSequence, colors: tuple[ColorFringe, ...]) -> Plan:
    first, second = colors
    if first.axis != second.axis or first.profile is not None or second.profile is not None:
        raise PatternError(f"sequence {sequence.name!r}: its colour fringes need one axis and no profile")
    if first.periods == second.periods:
        raise PatternError(f"sequence {sequence.name!r}: both colour fringes have {first.periods:g} periods")
    return Plan("two_color", sequence.size, first.axis, (), (), colors, 2)


def _fringes(sequence: FrameSequence) -> tuple[Shifted, ...]:
    found: dict[float, list[int]] = {}
    for number, frame in enumerate(sequence.frames):
        if isinstance(frame, Fringe):
            found.setdefault(frame.periods, []).append(number)
    out = []
    for periods, numbers in sorted(found.items(), reverse=True):
        shown: list[Any] = [sequence.frames[n] for n in numbers]
        if len({(f.mean, f.amplitude, f.channels) for f in shown}) != 1:
            raise PatternError(f"sequence {sequence.name!r}: the fringes of {periods:g} periods differ in their light")
        out.append(Shifted.of(periods, tuple(numbers), np.array([f.shift for f in shown])))
    return tuple(out)


def _check_bits(sequence: FrameSequence, bits: tuple[tuple[int, GrayBit], ...], fringes: tuple[Shifted, ...]) -> None:
    codes = {(b.bits, b.cells) for _, b in bits}
    if len(codes) != 1 or {b.bit for _, b in bits} != set(range(bits[0][1].bits)):
        raise PatternError(f"sequence {sequence.name!r}: the bits of its Gray code are not one whole code")
    if len(fringes) != 1 or bits[0][1].cells < fringes[0].periods:
        raise PatternError(
            f"sequence {sequence.name!r}: a Gray code of {bits[0][1].cells:g} cells numbers the periods of one fringe "
            "that has no more of them"
        )
