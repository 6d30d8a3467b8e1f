"""Visibility: of two segments with an order jump between them, the smaller is wrong if the other camera cannot see it.

A strip that only this camera sees takes an order that leads to another part of the same surface in the other image,
whose texture may be the same everywhere. With the order that continues its neighbour, the strip lies outside the other
image, behind a nearer surface, or costs as little. A true surface is contradicted there.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import serial
from pipeline.fringe_order.order_candidates import COST_UNOBSERVED
from pipeline.fringe_order.semi_global_aggregation import NONE
from pipeline.fringe_order.visibility.order_jumps import Jumps
from pipeline.fringe_order.visibility.uniqueness import Claims

LEAST_PLACES, LEAST_SHARE, SHARE_OF_PART = 8, 0.6, 0.2
"""Places where phase and texture continue, and their share of all where these segments meet, that show a jump; the
share from which that of a part may be hidden among those of the whole."""
PER_WIDTH = 0.5
"""Such places, divided by the square root of a segment's lattice pixels: few of a large segment are an accident."""
LEAST_CONFIRMED = 0.1
"""Share of a segment's pixels below which the left-right check has rejected it, so that it is no evidence."""
LEAST_EXPLAINED = 0.55
"""Share of a segment's pixels that the continued order explains."""
_LITTLE = np.float32(0.05)
"""Difference of costs up to which two orders explain a pixel alike."""
_NEARER = 2
"""Lattice pixels by which a claim's ray passes another one's before the surface is in front of it."""


def may_have_parts(jumps: Jumps, sizes: NDArray[np.int32]) -> bool:
    """Whether a part of a segment may have an order jump that is not shown of the whole; arguments as below."""
    smaller = np.minimum(sizes[jumps.first], sizes[jumps.second])
    shown = jumps.continuing >= np.maximum(LEAST_SHARE * jumps.places, PER_WIDTH * np.sqrt(smaller))
    possible = jumps.continuing >= np.maximum(LEAST_PLACES, SHARE_OF_PART * jumps.places)
    return bool((possible & ~shown).any())


def unseen_segments(
    label: NDArray[np.uint16], sizes: NDArray[np.int32], jumps: Jumps, order: NDArray[np.int16],
    confirmed: NDArray[np.int16], owner: NDArray[np.int32], claims_of: Callable[[NDArray[np.int16]], Claims], axis: int,
    nearer: int, smallest: int,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which segments (n,) have the order of another surface.

    Args:
        label, sizes, jumps: of :class:`pipeline.fringe_order.visibility.order_jumps.Segments`.
        order: (h, w) of the search; confirmed: (h, w) of the left-right check; owner: of :func:`nearest_claims`.
        claims_of: returns the claims of orders (h, w).
        axis: 0 = the other camera lies beside this one, 1 = above or below it; nearer: 1 or -1, direction along it in
            which, of the rays through one pixel of the other camera, those of nearer points lie.
        smallest: pixels from which a segment makes a surface.
    """
    n = len(sizes)
    known = np.zeros(n + 1, np.int64)
    count_known(label.reshape(-1), confirmed.reshape(-1), known)
    known = known[1:]
    change = _changes(jumps, sizes, known >= smallest, known >= np.maximum(smallest, LEAST_CONFIRMED * sizes))
    # The kernels are called without a candidate as well, or they would be compiled in the middle of a live run.
    moved = np.concatenate([np.zeros(1, np.int16), change])[label] if change.any() else np.zeros((0, 0), np.int16)
    some = np.s_[: len(moved), : moved.shape[1]]
    own, continued = (np.where(moved != 0, orders, NONE) for orders in (order[some], order[some] + moved))
    claimed, alternative = claims_of(own), claims_of(continued)
    counts = np.zeros((n, 2), np.int64)
    count_explained(
        label, claimed.place, claimed.cost, alternative.place, alternative.cost, continued, owner, axis, nearer, counts
    )  # fmt: skip
    return np.asarray((change != 0) & (counts[:, 1] >= LEAST_EXPLAINED * counts[:, 0]))


def _changes(
    jumps: Jumps, sizes: NDArray[np.int32], published: NDArray[np.bool_], confirmed: NDArray[np.bool_]
) -> NDArray[np.int16]:
    """Change of order (segments,) by which published segments continue larger, confirmed ones, 0 = none."""
    first = sizes[jumps.first] <= sizes[jumps.second]
    smaller, larger = (np.where(which, jumps.first, jumps.second) for which in (first, ~first))
    chosen = published[smaller] & confirmed[larger]
    j, smaller, first = Jumps(*(field[chosen] for field in jumps)), smaller[chosen], first[chosen]
    change = np.where(first, j.change, -j.change)
    keys, group = np.unique(np.stack([smaller, change]), axis=1, return_inverse=True)
    continuing, places = (np.bincount(group.reshape(-1), x, keys.shape[1]) for x in (j.continuing, j.places))
    least = np.maximum(np.maximum(LEAST_PLACES, LEAST_SHARE * places), PER_WIDTH * np.sqrt(sizes[keys[0]]))
    shown = np.flatnonzero(continuing >= least)
    # Of several the one with most places is assigned last.
    shown = shown[np.argsort(continuing[shown], kind="stable")]
    result = np.zeros(len(sizes), np.int16)
    result[keys[0, shown]] = keys[1, shown]
    return result


@serial
def count_known(label: Any, order: Any, counts: Any) -> None:
    """Pixels of each label (n,) that have an order, added to ``counts`` (labels,)."""
    for j in range(label.shape[0]):
        counts[label[j]] += order[j] != NONE


@serial
def nearest_claims(place: Any, axis: int, nearer: int, owner: Any) -> None:
    """Lattice pixel of the nearest surface that claims each place, ``owner`` (places,) int32, -1 before.

    Args:
        place: (h, w) of the left-right check; axis, nearer: as of :func:`unseen_segments`.
    """
    h, w = place.shape
    for i in range(h):
        for j in range(w):
            c = place[i, j]
            if c >= 0:
                before = owner[c]
                # Divisions of 32 bits without sign take a fraction of the time.
                row, column = np.uint32(before) // np.uint32(w), np.uint32(before) % np.uint32(w)
                ahead = nearer * ((j - np.int64(column)) if axis == 0 else (i - np.int64(row)))
                if before < 0 or ahead > 0:
                    owner[c] = i * w + j


@serial
def count_explained(
    label: Any, place: Any, cost: Any, new_place: Any, new_cost: Any, continued: Any, owner: Any, axis: int,
    nearer: int, counts: Any,
) -> None:  # fmt: skip
    """Pixels of segments, and those that the continued orders explain, ``counts`` (segments, 2).

    Args:
        place, cost: of the orders' claims; new_place, new_cost: of the continued ones'.
        continued: (h, w) int16, NONE where there is none; owner: of :func:`nearest_claims`.
    """
    h, w = continued.shape
    for i in range(h):
        for j in range(w):
            if continued[i, j] == NONE:
                continue
            k = np.int64(label[i, j])
            counts[k - 1, 0] += 1
            c = new_place[i, j]
            if c < 0:
                counts[k - 1, 1] += 1
                continue
            own = cost[i, j] if place[i, j] >= 0 else COST_UNOBSERVED
            other = owner[c]
            hidden = False
            if other >= 0:
                y, x = other // w, other % w
                ahead = nearer * ((x - j) if axis == 0 else (y - i))
                hidden = label[y, x] != 0 and label[y, x] != k and ahead > _NEARER
            if hidden or new_cost[i, j] <= own + _LITTLE:
                counts[k - 1, 1] += 1
