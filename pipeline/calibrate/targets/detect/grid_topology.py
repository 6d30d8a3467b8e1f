"""Discs that stand in a square lattice: which of them are neighbours.

A tilted circle tells how its surroundings are stretched: measured in its own half axes the four neighbours of a disc
stand at equal distances and right angles, under any tilt. Four discs that do so start a lattice; it grows disc by disc
to the places that its nearest rows and columns predict, so that neither perspective nor a lens's distortion matters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.targets.detect.disc_candidates import Discs

Array = NDArray[np.float64]
Place = tuple[int, int]

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
"""How far the fourth disc of a square may be from where the three others want it, in sides."""
_REACH = 0.3
"""How far a disc may be from its predicted place, in steps."""
_STEPS: tuple[Place, ...] = ((1, 0), (0, 1), (-1, 0), (0, -1))
_LEAST = 4
_MOST_SEEDS = 60


@dataclass(frozen=True, slots=True, eq=False)
class Lattice:
    """Discs in a lattice.

    Args:
        places: (n, 2) integer places a, b; the step in a, then the step in b turns clockwise in the image (from
            right to down), so a lattice is never mirrored.
        indices: (n,) of the discs.
    """

    places: NDArray[np.int64]
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
    found: list[Lattice] = []
    tried = 0
    for seed in seeds:
        if not free[list(seed)].all():
            continue
        grown = _grow(discs, seed, free)
        tried += 1
        if len(grown) >= _LEAST:
            places = np.array(list(grown), dtype=np.int64)
            found.append(Lattice(places, np.array(list(grown.values()), dtype=np.int64)))
            # A false start must not keep its discs from the true lattice.
            if len(grown) >= 9:
                free[found[-1].indices] = False
        if tried >= _MOST_SEEDS or sum(len(lattice) >= 9 for lattice in found) >= 3 * most:
            break
    found.sort(key=lambda lattice: -len(lattice))
    return _apart(found)[:most]


def _apart(found: list[Lattice]) -> list[Lattice]:
    taken: set[int] = set()
    kept = []
    for lattice in found:
        indices = set(lattice.indices.tolist())
        if not indices & taken:
            kept.append(lattice)
            taken |= indices
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
    """Squares (p, p + a, p + b, p + a + b) of discs, the most regular ones with the nearest discs first."""
    inverse = np.linalg.inv(discs.shapes)
    found: list[tuple[float, tuple[int, int, int, int]]] = []
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
        turns = np.outer(x, y) > np.outer(y, x)
        for a, b in zip(*np.nonzero(square & turns), strict=True):
            error = np.linalg.norm((vectors - vectors[a] - vectors[b]) @ inverse[index], axis=1)
            c = int(error.argmin())
            side = 0.5 * (length[a] + length[b])
            if c in (a, b) or error[c] > _CLOSES * side:
                continue
            # A disc in the middle: these four belong to every other row and column only.
            middle = np.linalg.norm((vectors - 0.5 * (vectors[a] + vectors[b])) @ inverse[index], axis=1).min()
            if middle > _CLOSES * side:
                unlike = error[c] / side + abs(cosine[a, b]) + abs(length[a] - length[b]) / side
                rank = unlike + 0.1 * side
                found.append((rank, (index, int(others[a]), int(others[b]), int(others[c]))))
    found.sort()
    return _seeds_apart(found)


def _seeds_apart(found: list[tuple[float, tuple[int, int, int, int]]]) -> list[tuple[int, int, int, int]]:
    """Seeds in order of rank, one for each first disc, so that one bad neighbourhood does not use up all trials."""
    seen: set[int] = set()
    kept = []
    for _, seed in found:
        if seed[0] not in seen:
            kept.append(seed)
            seen.add(seed[0])
    return kept


def _grow(discs: Discs, seed: tuple[int, int, int, int], free: NDArray[np.bool_]) -> dict[Place, int]:
    """All discs that continue the square ``seed`` without a gap."""
    centres, radii, tones = discs.centres, discs.radii, discs.contrast
    nodes: dict[Place, int] = dict(zip(((0, 0), (1, 0), (0, 1), (1, 1)), seed, strict=True))
    used = ~free
    used[list(seed)] = True
    refused: set[tuple[Place, int]] = set()
    while True:
        best = _predictions(nodes, centres, refused)
        if not best:
            return nodes
        for support, place, guess, step, beside in best:
            if place in nodes:
                continue
            far = np.linalg.norm(centres - guess, axis=1)
            alike = (np.minimum(radii, radii[beside]) > _SIZES * np.maximum(radii, radii[beside])) & (
                np.minimum(tones, tones[beside]) > _TONES * np.maximum(tones, tones[beside])
            )
            far[used | ~alike] = np.inf
            nearest = int(far.argmin())
            if far[nearest] < _REACH * step:
                nodes[place], used[nearest] = nearest, True
            else:
                refused.add((place, support))


def _predictions(
    nodes: dict[Place, int], centres: Array, refused: set[tuple[Place, int]]
) -> list[tuple[int, Place, Array, float, int]]:
    """Empty places beside the lattice, best supported first: support, place, where, length of a step, a neighbour."""
    around = {(a + da, b + db) for a, b in nodes for da, db in _STEPS if (a + da, b + db) not in nodes}
    found = []
    for a, b in sorted(around):
        guesses, steps, beside = [], [], -1
        for da, db in _STEPS:
            one = nodes.get((a - da, b - db))
            if one is None:
                continue
            beside = one
            two, three = nodes.get((a - 2 * da, b - 2 * db)), nodes.get((a - 3 * da, b - 3 * db))
            if two is not None:
                step = centres[one] - centres[two]
                steps.append(step)
                # In perspective steps change by a factor; the change seen last goes on.
                change = step - (centres[two] - centres[three]) if three is not None else 0.0
                guesses.append(centres[one] + step + change)
            for sa, sb in ((db, da), (-db, -da)):
                side, corner = nodes.get((a + sa, b + sb)), nodes.get((a - da + sa, b - db + sb))
                if side is not None and corner is not None:
                    step = centres[side] - centres[corner]
                    steps.append(step)
                    guesses.append(centres[one] + step)
        if guesses and ((a, b), len(guesses)) not in refused:
            length = float(np.min([np.linalg.norm(step) for step in steps]))
            found.append((len(guesses), (a, b), np.mean(guesses, axis=0), length, beside))
    found.sort(key=lambda item: -item[0])
    most = found[0][0] if found else 0
    return [item for item in found if item[0] >= min(most, 3)] if most else []
