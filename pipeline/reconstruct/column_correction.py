"""Correction of the projector columns from the measurement itself.

The metric comes from the two cameras; the projector only selects the integer order. A projector that moved by a
fraction of a pixel since calibration causes a constant offset of its columns, which the images show: first a
one-dimensional search for the offset with the least mean best cost, then an affine fit of observed minus predicted
columns on accepted points.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pipeline.fringe_order.margins.order_margins import CLEAR_GAIN
from pipeline.geometry.view_tables import View
from pipeline.match.match_result import OUTSIDE, PIXEL_STEPS, RESIDUAL_STEP, MatchResult

F64 = NDArray[np.float64]
Correction = F64
"""(3,) offset, slope along, slope across: observed minus calibrated projector coordinate."""

CorrectionState = tuple[Correction, bool]
"""A correction, and whether it was measured."""

NO_CORRECTION: Correction = np.zeros(3)
CLEARLY_MORE, PER_COLUMN = 0.025, 0.01
"""How much more an offset costs on average that is clearly worse than another, and how much more each column counts:
small offsets are more probable."""
PER_MOVED_COLUMN, MOVED_COLUMNS = 0.05, 0.75
"""How much more each of the first columns counts in the search, and how many: with a wall behind the volume a wrong
offset of most of a column may cost less than the right one, and a projector drifts by a fraction of a column."""
PER_OUTSIDE = 0.05
"""Weight of what the orders beyond the volume save: nothing at the right offset of a scene inside it."""
COMPARED_WITHIN, _MOST_MINIMA = 0.15, 4
"""How much more improbable than the best one an offset may be, in units of the mean cost, if textures are to decide;
how many offsets are compared."""
PER_TEXTURE = 0.1
"""What a texture difference e times as large counts in units of the mean cost."""
NOISE_COSTS = (0.003, 0.006, 0.012)
"""Mean costs that noise alone gives a pixel with its right order."""
_SHARES = (0.02, 0.05, 0.1, 0.2, 0.4, 0.7)
"""Shares of such pixels that are tried."""
_REFINED = 6
"""Minima of the mean cost about which finer offsets are tried."""
CLEAR_RATIO, _NEAR = 1.5, 0.3
"""How many times the gain near the chosen offset that of one which replaces it must be, and what is near, columns."""
_SAME, _FARTHER, _MINIMUM_FARTHER, _VAGUE_FARTHER, _MOST_OTHERS = 0.1, 0.2, 0.3, 0.5, 2
"""Distance up to which offsets are alike, columns; how much farther from 0 another one may be, as projectors drift
little, the second one where it is a minimum of its own and pixels agree up to noise, the third one where hardly any
pixels do; how many others are compared."""


def offsets_to_try(largest: float, step: float = 0.25) -> F64:
    """Offsets from the centre outwards, so that the smaller one is taken at a tie.

    The cost is low within about 0.15 columns of the right offset only, so larger steps may miss it.
    """
    n = int(np.floor(largest / step + 1e-9))
    steps = np.arange(-n, n + 1) * step
    return np.asarray(steps[np.argsort(np.abs(steps), kind="stable")], dtype=np.float64)


def finer_offsets(offsets: F64, costs: F64, step: float) -> F64:
    """Offsets (m,) a step to both sides of the least ones: the costs fall to those of noise in a twentieth of a column.

    Args:
        offsets: (n,) at which there is a mean cost, (n,); two steps apart.
    """
    along = np.argsort(offsets)
    padded = np.concatenate([[np.inf], costs[along], [np.inf]])
    least = along[(padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:])]
    best = offsets[least[np.argsort(costs[least], kind="stable")][:_REFINED]]
    return np.unique(np.concatenate([best - step, best + step]))


def improbability(offsets: F64, with_margin: F64, inside: F64) -> F64:
    """How improbable each offset is, (n,), in units of the mean cost.

    A wall behind the volume agrees with wrong orders inside it at some wrong offset, so the search with the margin
    decides; with its many orders a bare plane fits at several offsets nearly alike, of which that counts that explains
    more of it inside. Small offsets are more probable.

    Args:
        offsets: (n,) columns; with_margin, inside: (n,) mean least costs with the margin and without.
    """
    moved, outside = np.abs(offsets), np.maximum(inside - with_margin, 0.0)
    few = PER_COLUMN * moved + PER_MOVED_COLUMN * np.minimum(moved, MOVED_COLUMNS)
    return np.asarray((with_margin + few + PER_OUTSIDE * outside).round(6), dtype=np.float64)


class OffsetLikelihood(NamedTuple):
    """Gain in log likelihood per pixel by assuming, at each offset, that some pixels have their right order.

    Of these the costs are those of noise: exponential with one of :data:`NOISE_COSTS`. The costs of the others are
    distributed as at most offsets. A wall behind the volume lowers the mean cost of a wrong offset, where its phases
    agree roughly with orders inside; only at the right one do the costs of some pixels fall to those of noise.

    Args:
        offsets: (n,) columns; gain: (n,).
    """

    offsets: F64
    gain: F64

    @classmethod
    def of(cls, offsets: F64, costs: Sequence[NDArray[np.float32]]) -> OffsetLikelihood:
        """From the least costs of the pixels at each offset."""
        edges = np.concatenate([[0.0], np.geomspace(1e-3, 0.5, 40), [np.inf]])
        counts = np.stack([np.histogram(each, edges)[0] for each in costs]).astype(np.float64)
        share = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1)
        usual = np.median(share, axis=0) + 1e-4
        usual /= usual.sum()
        gain = np.zeros(len(offsets))
        for scale in NOISE_COSTS:
            ratio = -np.diff(np.exp(-edges / scale)) / usual
            for part in _SHARES:
                gain = np.maximum(gain, share @ np.log(1 - part + part * ratio))
        return cls(offsets, gain)

    def at(self, offset: float) -> float:
        """The gain at an offset."""
        along = np.argsort(self.offsets)
        return float(np.interp(offset, self.offsets[along], self.gain[along]))

    @property
    def probable(self) -> F64:
        """The gain (n,) with what is known before: small offsets are more probable."""
        return np.asarray(self.gain / (1 + np.abs(self.offsets)), dtype=np.float64)

    def near(self, offset: float) -> float:
        """The largest gain near an offset."""
        return float(self.gain[np.abs(self.offsets - offset) <= _NEAR].max(initial=0.0))

    def clear_offset(self, chosen: float) -> float:
        """The offset at which clearly more pixels agree up to noise than near the chosen one, if there is one.

        Of a plane's pixels all may agree at several offsets; small ones are more probable.
        """
        probable = self.probable
        best = int(np.argmax(probable))
        here = float(probable[np.abs(self.offsets - chosen) <= _NEAR].max(initial=0.0))
        clearly = self.gain[best] > CLEAR_GAIN and probable[best] > CLEAR_RATIO * here
        return float(self.offsets[best]) if clearly else chosen


def minima(offsets: F64, values: F64) -> list[int]:
    """Numbers of the offsets that may be the right one, the most probable first: minima not far above the least one.

    Args:
        values: (n,) of :func:`improbability`.
    """
    by_place = np.argsort(offsets)
    along = np.concatenate([[np.inf], values[by_place], [np.inf]])
    least = by_place[(along[1:-1] <= along[:-2]) & (along[1:-1] <= along[2:])]
    least = least[values[least] <= values.min() + COMPARED_WITHIN]
    return [int(n) for n in least[np.argsort(values[least], kind="stable")][:_MOST_MINIMA]]


def other_shifts(offsets: F64, with_margin: F64, likelihood: OffsetLikelihood, here: float, cost: float) -> F64:
    """Changes (n,) of the correction's offset that explain the pair about as well, and halves of them; columns.

    A wall behind the volume may agree with wrong orders inside it after a small change of the offset, and then
    determines the correction itself. Whether the orders win clearly must not depend on the offset that they chose.

    Args:
        offsets, with_margin: as of :func:`improbability`; cost: the same of the correction.
        likelihood: offsets whose gain is clearly smaller than that of the correction do not explain the pair.
        here: the correction in the middle of the points, columns.
    """
    probable = with_margin + PER_COLUMN * np.abs(offsets)
    limit = min(float(probable.min()), cost + PER_COLUMN * abs(here)) + CLEARLY_MORE
    gain = likelihood.near(here)
    farther = np.full(len(offsets), _FARTHER if gain >= CLEAR_GAIN else _VAGUE_FARTHER)
    if gain >= CLEAR_GAIN:
        farther[minima(offsets, with_margin)] = _MINIMUM_FARTHER
    small = np.abs(offsets) <= abs(here) + farther
    least = np.where((gain >= CLEAR_GAIN) | (np.abs(offsets) > abs(here) + _FARTHER), gain / CLEAR_RATIO, 0.0)
    agreeing = np.array([likelihood.near(offset) for offset in offsets]) >= least
    others = np.flatnonzero((probable <= limit) & small & agreeing & (np.abs(offsets - here) >= _SAME))
    return _with_halves(offsets[others[np.argsort(probable[others], kind="stable")][:_MOST_OTHERS]] - here)


def with_others(shifts: F64, further: Sequence[float]) -> F64:
    """Changes of :func:`other_shifts`, and the first further one that is like none of them; halves as there."""
    known = list(shifts[: len(shifts) // 2])
    unlike = (each for each in further if abs(each) >= _FARTHER and all(abs(each - one) >= _SAME for one in known))
    return _with_halves(np.array([*known, *islice(unlike, 1)]))


def _with_halves(shifts: F64) -> F64:
    return np.asarray(np.concatenate([shifts, shifts / 2]), dtype=np.float64)


def warnings_of(shifts: F64) -> tuple[str, ...]:
    """Why surfaces without texture get no points, a sentence for any offsets of :func:`other_shifts`."""
    if not len(shifts):
        return ()
    # Halves of them are compared as well.
    columns = ", ".join(f"{shift:+.2f}" for shift in shifts[: len(shifts) // 2])
    return (
        f"the first pair agrees with other offsets of the projector as well ({columns} columns): surfaces of uniform "
        "texture get no points; start with more depth or texture in view",
    )


def column_differences(view: View, match: MatchResult, correction: Correction) -> tuple[F64, F64, F64]:
    """Observed minus calibrated projector coordinate of matched pixels (a subset), and their coordinates."""
    part = np.s_[::3, ::2]
    some = match.valid[part].astype(bool) & (np.abs(match.residual_normalised[part]) < 1.5 / RESIDUAL_STEP)
    some &= (match.projector_u[part] != OUTSIDE) & (match.projector_v[part] != OUTSIDE)
    pixels = [(plane[part][some] + 0.5) / PIXEL_STEPS - 0.5 for plane in (match.projector_u, match.projector_v)]
    along, across = pixels[view.first_axis], pixels[1 - view.first_axis]
    column = along + correction[0] + correction[1] * along + correction[2] * across
    rate = np.gradient(view.column_to_phase.astype(np.float64))
    residual = RESIDUAL_STEP * match.residual_normalised[part][some]
    return column - along + residual / np.interp(column, np.arange(len(rate)), rate), along, across


def affine_fit(along: F64, across: F64, difference: F64, *, limit: float) -> Correction:
    """Robust affine fit (three re-weighted passes) of column differences on accepted points.

    Args:
        along, across: projector coordinates of the points, pixels.
        difference: observed minus calibrated coordinate, pixels.
        limit: of the correction; where it would be exceeded, only a constant is fitted.
    """
    design = np.stack([np.ones_like(along), along, across], axis=1)
    weights = np.ones_like(along)
    solution = np.zeros(3)
    for _ in range(3):
        w = np.sqrt(weights)[:, None]
        solution = np.linalg.lstsq(design * w, difference * w[:, 0], rcond=None)[0]
        error = np.abs(difference - design @ solution)
        scale = 1.4826 * float(np.median(error)) + 1e-6
        weights = 1 / (1 + (error / (2 * scale)) ** 2)
    if np.abs(design @ solution).max() > limit:
        return np.array([float(np.clip(np.median(difference), -limit, limit)), 0.0, 0.0])
    return solution
