"""Search for square lattices among discs.

The shape of a tilted circle gives the local affine distortion: measured in its half axes the four neighbours of a disc
have equal distances and right angles under any tilt. Four such discs start a lattice; it grows disc by disc to the
positions that the nearest rows and columns predict, so that perspective and lens distortion do not matter.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.detect.disc_candidates import Discs

Array = NDArray[np.float64]
Position = tuple[int, int]

_NEIGHBOURS = 14
_NEAREST, _FARTHEST = 1.8, 11.0
"""Distance of neighbours in radii."""
_SIZES = 0.55
"""Least ratio of the radii of neighbours."""
_TONES = 0.25
"""Least ratio of their contrasts (a shadow may fall between them)."""
_RIGHT_ANGLE = 0.42
_SIDES = 0.7
_CLOSES = 0.2
"""Largest distance of the fourth disc of a square from its prediction by the other three, in sides."""
_REACH = 0.3
"""Largest distance of a disc from its predicted position, in steps."""
_STEPS: tuple[Position, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
_LEAST = 4
_MOST_SEEDS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Discs in a lattice.

    Args:
        positions: (n, 2) integer positions a, b; the step in a, then the step in b turns clockwise in the image (from
            right to down), so a lattice is never mirrored.
        indices: (n,) of the discs.
    """

    positions: NDArray[np.int64]
    indices: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.indices)


def lattices(discs: Discs, *, most: int = 4) -> list[Lattice]:
    """The lattices among the discs, largest first; no disc is in two of them."""
    if len(discs) < _LEAST:
        return []
    near, apart = _neighbours(discs)
    seeds = _squares(discs, near, apart)
    free = np.ones(len(discs), dtype=bool)
    candidates: list[Lattice] = []
    tried = 0
    for seed in seeds:
        if not free[list(seed)].all():
            continue
        lattice_nodes = _grow(discs, seed, free)
        tried += 1
        if len(lattice_nodes) >= _LEAST:
            positions = np.array(list(lattice_nodes), dtype=np.int64)
            candidates.append(Lattice(positions, np.array(list(lattice_nodes.values()), dtype=np.int64)))
            # Discs of a small lattice stay free: it may be a false start.
            if len(lattice_nodes) >= 9:
                free[candidates[-1].indices] = False
        if tried >= _MOST_SEEDS or sum(len(lattice) >= 9 for lattice in candidates) >= 3 * most:
            break
    candidates.sort(key=lambda lattice: -len(lattice))
    return _apart(candidates)[:most]


def _apart(candidates: list[Lattice]) -> list[Lattice]:
    used_indices: set[int] = set()
    kept = []
    for lattice in candidates:
        indices = set(lattice.indices.tolist())
        if not indices & used_indices:
            kept.append(lattice)
            used_indices |= indices
    return kept


def _neighbours(discs: Discs) -> tuple[NDArray[np.int64], Array]:
    """For each disc its nearest alike discs (n, k), -1 where there are fewer, and their distances in radii (n, k)."""
    n, k = len(discs), min(_NEIGHBOURS, len(discs) - 1)
    inverse = np.linalg.inv(discs.shapes)
    radii, tones = discs.radii, discs.contrast
    near, apart = np.full((n, k), -1, dtype=np.int64), np.full((n, k), np.inf)
    for index in range(n):
        radius, tone = radii[index], tones[index]
        alike = (np.minimum(radii, radius) > _SIZES * np.maximum(radii, radius)) & (
            np.minimum(tones, tone) > _TONES * np.maximum(tones, tone)
        )
        alike[index] = False
        others = np.flatnonzero(alike)
        distance = np.linalg.norm((discs.centres[others] - discs.centres[index]) @ inverse[index], axis=1)
        usable = (distance > _NEAREST) & (distance < _FARTHEST)
        others, distance = others[usable], distance[usable]
        order = np.argsort(distance, kind="stable")[:k]
        near[index, : len(order)], apart[index, : len(order)] = others[order], distance[order]
    return near, apart


def _squares(discs: Discs, near: NDArray[np.int64], apart: Array) -> list[tuple[int, int, int, int]]:
    """Find squares (p, p + a, p + b, p + a + b) of discs, the most regular ones with the nearest discs first."""
    inverse = np.linalg.inv(discs.shapes)
    candidates: list[tuple[float, tuple[int, int, int, int]]] = []
    for index in range(len(discs)):
        others = near[index][near[index] >= 0]
        if len(others) < 3:
            continue
        vectors = discs.centres[others] - discs.centres[index]
        flat = vectors @ inverse[index]
        length = apart[index][: len(others)]
        cosine = flat @ flat.T / np.outer(length, length)
        # Half axes that were measured on few pixels are rough: the tolerance is wide, the fourth disc decides.
        square = (np.abs(cosine) < _RIGHT_ANGLE) & (
            np.minimum.outer(length, length) > _SIDES * np.maximum.outer(length, length)
        )
        x, y = vectors.T
        clockwise = np.outer(x, y) > np.outer(y, x)
        a, b = np.nonzero(square & clockwise)
        sums = vectors[a] + vectors[b]
        error = np.linalg.norm((vectors - sums[:, np.newaxis]) @ inverse[index], axis=2)
        c, each = error.argmin(axis=1), np.arange(len(a))
        side = 0.5 * (length[a] + length[b])
        # A disc in the middle: these four belong to every other row and column only.
        middle = np.linalg.norm((vectors - 0.5 * sums[:, np.newaxis]) @ inverse[index], axis=2).min(axis=1)
        closed = (c != a) & (c != b) & (error[each, c] <= _CLOSES * side) & (middle > _CLOSES * side)
        unlike = error[each, c] / side + np.abs(cosine[a, b]) + np.abs(length[a] - length[b]) / side
        rank = unlike + 0.1 * side
        for one in np.flatnonzero(closed):
            seed = index, int(others[a[one]]), int(others[b[one]]), int(others[c[one]])
            candidates.append((float(rank[one]), seed))
    candidates.sort()
    return _seeds_apart(candidates)


def _seeds_apart(candidates: list[tuple[float, tuple[int, int, int, int]]]) -> list[tuple[int, int, int, int]]:
    """Seeds in order of rank, one for each first disc, so that one bad neighbourhood does not use up all trials."""
    first_discs: set[int] = set()
    kept = []
    for _, seed in candidates:
        if seed[0] not in first_discs:
            kept.append(seed)
            first_discs.add(seed[0])
    return kept


def _grow(discs: Discs, seed: tuple[int, int, int, int], free: NDArray[np.bool_]) -> dict[Position, int]:
    """All discs that continue the square ``seed`` without a gap."""
    centres, radii, tones = discs.centres, discs.radii, discs.contrast
    nodes: dict[Position, int] = dict(zip(((0, 0), (1, 0), (0, 1), (1, 1)), seed, strict=True))
    used = ~free
    used[list(seed)] = True
    rejected: set[tuple[Position, int]] = set()
    places = centres.tolist()  # Python's own numbers: pairs are too small for arrays
    while True:
        best = _predictions(nodes, places, rejected)
        if not best:
            return nodes
        for support, position, guess, step, beside in best:
            if position in nodes:
                continue
            far = np.linalg.norm(centres - guess, axis=1)
            alike = (np.minimum(radii, radii[beside]) > _SIZES * np.maximum(radii, radii[beside])) & (
                np.minimum(tones, tones[beside]) > _TONES * np.maximum(tones, tones[beside])
            )
            far[used | ~alike] = np.inf
            nearest = int(far.argmin())
            if far[nearest] < _REACH * step:
                nodes[position], used[nearest] = nearest, True
            else:
                rejected.add((position, support))


def _predictions(
    nodes: dict[Position, int], centres: list[list[float]], rejected: set[tuple[Position, int]]
) -> list[tuple[int, Position, tuple[float, float], float, int]]:
    """Empty positions beside the lattice, best supported first: support, position, pixel, step length, neighbour."""
    around = {(a + da, b + db) for a, b in nodes for da, db in _STEPS if (a + da, b + db) not in nodes}
    candidates = []
    for a, b in sorted(around):
        u, v, steps, beside = 0.0, 0.0, [], -1
        for da, db in _STEPS:
            one = nodes.get((a - da, b - db))
            if one is None:
                continue
            beside = one
            (u1, v1), two = centres[one], nodes.get((a - 2 * da, b - 2 * db))
            if two is not None:
                du, dv = _step(centres[two], centres[one])
                steps.append(math.hypot(du, dv))
                u, v = u + u1 + du, v + v1 + dv
                three = nodes.get((a - 3 * da, b - 3 * db))
                if three is not None:
                    # In perspective steps change by a factor; the last change is continued.
                    before_u, before_v = _step(centres[three], centres[two])
                    u, v = u + du - before_u, v + dv - before_v
            for sa, sb in ((db, da), (-db, -da)):
                side, corner = nodes.get((a + sa, b + sb)), nodes.get((a - da + sa, b - db + sb))
                if side is not None and corner is not None:
                    du, dv = _step(centres[corner], centres[side])
                    steps.append(math.hypot(du, dv))
                    u, v = u + u1 + du, v + v1 + dv
        support = len(steps)
        if support and ((a, b), support) not in rejected:
            candidates.append((support, (a, b), (u / support, v / support), min(steps), beside))
    candidates.sort(key=lambda item: -item[0])
    most = candidates[0][0] if candidates else 0
    return [item for item in candidates if item[0] >= min(most, 3)] if most else []


def _step(start: list[float], end: list[float]) -> tuple[float, float]:
    return end[0] - start[0], end[1] - start[1]
