"""Sequences of frames of the measuring modes.

Three frequencies whose beats have one period over the whole projector ("heterodyne": Gruber and Haeusler, Optik 89,
118, 1992) are all fine: each of them measures as well as the others. A Gray code numbers the periods of one fringe
(Sansoni et al., Appl. Opt. 36, 4463, 1997). Two colour fringes are two single shots whose wrong orders disagree.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import ceil, log2, pi

from pipeline.common.errors import PatternError
from pipeline.pattern.color_fringe import ColorFringe
from pipeline.pattern.projected_frames import CHANNELS, GRAY_AMPLITUDE, GRAY_MEAN, Axis, Fringe, GrayBit, check_size
from pipeline.pattern.sequence import Frame, FrameSequence

MODES = ("two_color", "heterodyne", "gray")
"""The modes other than the single shot, which needs no sequence."""

FEWEST_PERIODS, MOST_STEPS = 4.0, 16
_SECOND = 0.8


def mode_sequence(
    name: str,
    size: tuple[int, int],
    *,
    periods: float = 96.0,
    steps: int = 4,
    axis: Axis = "x",
    mean: float = GRAY_MEAN,
    amplitude: float = GRAY_AMPLITUDE,
    channels: tuple[str, ...] = CHANNELS,
) -> FrameSequence:
    """The frames of a mode in their order.

    Args:
        name: one of :data:`MODES`; it becomes the sequence's name.
        size: (width, height) of the projector, pixels.
        periods: of the finest fringe over the width (axis x) or the height; may be fractional, at least 4.
        steps: images of each fringe that is shifted, 3 to 16. With three, an uncalibrated response of the projector
            changes the phase by a quarter of a radian; with four by a hundredth.
        axis: direction along which the phase grows.
        mean, amplitude: light of fringes and bits; of colour fringes see :class:`ColorFringe`.
        channels: lit by fringes and bits; all for a monochrome projector.
    """
    check_size(size)
    length = size[0] if axis == "x" else size[1]
    if name not in MODES:
        raise PatternError(f"mode {name!r:.80} is not known; there are {', '.join(MODES)}")
    if not FEWEST_PERIODS <= periods <= length / 4:
        raise PatternError(f"periods is {periods}, expected {FEWEST_PERIODS:g} to {length / 4:g}, four pixels each")
    if not 3 <= steps <= MOST_STEPS:
        raise PatternError(f"steps is {steps}, expected 3 to {MOST_STEPS}")
    if name == "two_color":
        return FrameSequence(name, [ColorFringe(size, p, axis) for p in (periods, _SECOND * periods)])  # type: ignore[arg-type]
    frames: list[Frame] = [
        Fringe(size, fringe, axis, 2 * pi * n / steps, mean, amplitude, channels)
        for fringe in (heterodyne_periods(periods) if name == "heterodyne" else (periods,))
        for n in range(steps)
    ]
    if name == "gray":
        frames += gray_bits(size, periods, axis, mean=mean, amplitude=amplitude, channels=channels)
    return FrameSequence(name, tuple(frames))


def heterodyne_periods(finest: float) -> tuple[float, float, float]:
    """Periods of three fringes: the beats of neighbours differ by one period, their common beat has one."""
    first = max(2, round(finest**0.5))
    return finest, finest - first, finest - 2 * first + 1


def gray_bits(
    size: tuple[int, int],
    periods: float,
    axis: Axis,
    *,
    mean: float = GRAY_MEAN,
    amplitude: float = GRAY_AMPLITUDE,
    channels: tuple[str, ...] = CHANNELS,
) -> Sequence[GrayBit]:
    """A Gray code of half periods: of the two edges of a code's bits next to a pixel one is always far away."""
    cells = 2 * periods
    bits = ceil(log2(cells))
    return [GrayBit(size, k, bits, False, axis, cells, mean, amplitude, channels) for k in range(bits)]
