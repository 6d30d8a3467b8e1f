"""Orders by which small surfaces continue what is beside them: there phase and brightness go on, the order does not.

At the border of a true surface the wrapped phase changes by any amount. Where it goes on by whole turns along a good
part of the border, and the brightness goes on too, the surface is a part of what is beside it, and the order of one of
both is wrong: the surface must win clearly against the order that continues. Slots and bars have such borders too, but
win by more. Where it goes on to pixels without an order, nothing confirms the surface's own, and it must win clearly
against every other one (see :mod:`pipeline.fringe_order.margins.order_margins`).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.connected_components import Surfaces
from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel_allocating
from pipeline.decode.decoder import PhaseMap
from pipeline.filter.surfaces.small_surfaces import boxes_of
from pipeline.fringe_order.margins.order_margins import Continued
from pipeline.match.match_result import TURN_STEPS, MatchResult

LEAST_SHARE, LEAST_PLACES = 0.25, 12
"""Share of the places along a border that show the same change of order, and number of such places, from which on it
counts."""
_CONTINUES = int(0.5 / (2 * np.pi) * TURN_STEPS)
"""Deviation from a whole number of turns up to which the phase continues, steps."""
_PER_RADIAN = np.float32(TURN_STEPS / (2 * np.pi))
_ALIKE, _COUNTS = 0.06, 0.5
"""Difference of two means of one texture, of their sum, and counts of noise."""
_MOST, _WITHOUT_ORDER, _NO_PLACE = 31, 1000, -1000
"""Largest change of order that is counted; values of :func:`_change` where the phase continues to a pixel without an
order, and where there is nothing to be compared."""
_INSIDE, _OUTSIDE = 3, 2
"""Pixels from the outermost one of a surface to the farther one of the two that the phase is extrapolated from, and to
the one beyond the border that it is compared with; those between see both sides."""


def continued_orders(
    match: MatchResult, left: PhaseMap, label: NDArray[np.uint16], surfaces: Surfaces, large: int,
    matched: NDArray[np.uint8],
) -> Continued:  # fmt: skip
    """The order by which each surface would continue what is beside it.

    Args:
        match, left: of the left image; label: (H, W), one more than the surface.
        large: pixels from which a surface is not tested.
        matched: (H, W) pixels whose order counts, ``match.valid`` or less.
    """
    f = surfaces
    n = len(f.sizes)
    found = Continued.none(n)
    find_changes(
        n, boxes_of(f), f.sizes, large, f.start, f.stop, f.count, f.first, f.surface, label,
        match.absolute_phase, matched, left.phase, left.valid, left.mean, *found,
    )  # fmt: skip
    return found


@inline
def _alike(a: Any, b: Any) -> bool:
    first, second = np.float32(a), np.float32(b)
    return bool(abs(first - second) <= np.float32(_ALIKE) * (first + second) + np.float32(_COUNTS))


@inline
def _change(
    label: Any, phase: Any, matched: Any, wrapped: Any, known: Any, mean: Any, i: int, j: int, down: int, right: int
) -> Any:  # fmt: skip
    """Change of order across the border beside (i, j) in a direction, 0 = does not continue, or one of the above."""
    height, width = label.shape
    y, x = i + _OUTSIDE * down, j + _OUTSIDE * right
    y3, x3 = i - _INSIDE * down, j - _INSIDE * right
    if min(y, y3) < 0 or max(y, y3) >= height or min(x, x3) < 0 or max(x, x3) >= width:
        return _NO_PLACE
    own = label[i, j]
    if label[i - down, j - right] != own or label[y3, x3] != own:
        return _NO_PLACE
    if not known[y, x] or not _alike(mean[i - down, j - right], mean[y, x]):
        return 0
    start = np.int64(phase[i - down, j - right])
    # Phases are known modulo 16 bits: from two pixels farther inside to this one, and on by one and a half as much.
    step = np.int64(np.int16(start - phase[y3, x3]))
    beyond = np.int64(phase[y, x] if matched[y, x] else np.int32(wrapped[y, x] * _PER_RADIAN))
    ahead = np.int64(np.int16(beyond - start - (3 * step) // 2))
    turns: Any = (ahead + TURN_STEPS // 2) // TURN_STEPS
    if abs(ahead - TURN_STEPS * turns) > _CONTINUES:
        return 0
    if not matched[y, x]:
        return _WITHOUT_ORDER
    return turns if abs(turns) <= _MOST else 0


@parallel_allocating
def find_changes(
    k: int, box: Any, sizes: Any, large: int, start: Any, stop: Any, count: Any, row: Any, surface: Any, label: Any,
    phase: Any, matched: Any, wrapped: Any, known: Any, mean: Any, change: Any, share: Any, jumps: Any, unknown: Any,
) -> None:  # fmt: skip
    """Those of surface ``k``; arguments as of :func:`continued_orders`, the last four are written."""
    if sizes[k] >= large:
        return
    last, own = label.shape[0] - 1, np.uint16(k + 1)
    places, without_order, found = 0, 0, np.zeros(2 * _MOST + 1, np.int32)
    for i in range(box[k, 0], box[k, 1] + 1):
        above, below = label[max(i - 1, 0)], label[min(i + 1, last)]
        for t in range(count[0, i]):
            if surface[row[i] + t] != k:
                continue
            begin, end = start[i, t], stop[i, t]
            for j in range(begin, end):
                for down, right, ends in (
                    (0, -1, j == begin), (0, 1, j == end - 1), (-1, 0, above[j] != own), (1, 0, below[j] != own),
                ):  # fmt: skip
                    if ends:
                        turns = _change(label, phase, matched, wrapped, known, mean, i, j, down, right)
                        if turns == _WITHOUT_ORDER:
                            without_order += 1
                        elif turns != _NO_PLACE:
                            found[turns + _MOST] += turns != 0
                        places += turns != _NO_PLACE
    best = np.argmax(found)
    if found[best] >= max(LEAST_PLACES, LEAST_SHARE * places):
        change[k], share[k] = best - _MOST, np.float32(found[best] / places)
    jumps[k], unknown[k] = np.float32(found.sum() / max(places, 1)), np.float32(without_order / max(places, 1))
