"""The fringe orders that a lattice pixel may have, and the cost of each.

A wrapped phase phi leaves the absolute phases phi + 2 pi k. Each is a projector column, which meets the pixel's viewing
ray at one point; the other camera must see the same phase at that point's image. On a plane, a candidate wrong by m
periods leaves a residual of 2 pi frac(m rho), rho = baseline left-right over baseline left-projector.

The k-th candidates of a tile of lattice pixels are computed together (see :mod:`pipeline.common.tile_math`).
"""

from __future__ import annotations

from math import pi
from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel_allocating
from pipeline.common.tile_math import TILE, clamped, decay, whole_turns
from pipeline.decode.pixel_descriptor import RADIANS, VALID, bias_of, mean_of, normalised_units, phase_units, units

COST_UNOBSERVED = np.float32(0.5)
RAY = 9
"""Numbers of a lattice pixel's ray, side by side since sometimes few pixels need them: ``lines`` of
:class:`pipeline.geometry.ray_tables.RayTable`, then the absolute phases between which the pixel's lies."""
COST_IMPOSSIBLE = np.float32(1000.0)
"""Cost of an order that the pixel cannot have."""
_COST_OUTSIDE = np.float32(4.0)
_MOST_TEXTURE = np.float32(0.4)
"""Less than COST_UNOBSERVED: on narrow bars every pixel is mixed with what is beside it, differently in both images."""
_MAX_PHASE_CHANGE = np.float32(2.0)
"""Largest change of a pixel's absolute phase from one pair to the next for which the prior is used, radians."""
_ZERO, _HALF, _ONE, _EIGHT = np.float32(0), np.float32(0.5), np.float32(1), np.float32(8)
_TURN, _PER_TURN = np.float32(2 * pi), np.float32(0.5 / pi)

# Slots of the scratch array of floats (tables take three each), and of the one of integers.
_PHI, _BIAS, _MEAN, _MOVE = (k * TILE for k in range(4))
_M0, _M1, _M2, _Q0, _Q1, _R0, _R1 = (k * TILE for k in range(4, 11))
_U, _FRACTION, _VISIBLE, _T0, _T1, _COST = (k * TILE for k in range(11, 17))
SLOTS = 17
_CELL, _P0, _P1, _PHASE, _NORMALISED = (k * TILE for k in range(5))
INTEGER_SLOTS = 5
PHI, MOVE, FRACTION, VISIBLE, COST, CELL = _PHI, _MOVE, _FRACTION, _VISIBLE, _COST, _CELL
"""Slots that other modules read; after :func:`candidate_costs` cell and rest of the place in the other image."""


@inline
def load_nodes(
    t: Any, k: Any, nodes: Any, pixels: Any, n: int, rays: Any, phase: Any, descriptors: Any, first: Any, count: Any,
    labels: int,
) -> int:  # fmt: skip
    """Fill the slots of a tile of lattice pixels, their first orders and counts; returns the largest count.

    Args:
        nodes, pixels: numbers of the n lattice pixels in the lattice and in the image.
        rays: (h w RAY), see :data:`RAY`; first, count: (h w); phase, descriptors: (H W).
    """
    for j in range(n):
        at = np.uint32(RAY * nodes[j])
        for c in range(7):
            t[_M0 + c * TILE + j] = rays[at + np.uint32(c)]
        t[_T0 + j], t[_T1 + j] = rays[at + np.uint32(7)], rays[at + np.uint32(8)]
    for j in range(n):
        m = np.uint32(pixels[j])
        t[_PHI + j], k[_P0 + j] = phase[m], descriptors[m]
    for j in range(TILE):
        x = k[_P0 + j]
        t[_BIAS + j] = bias_of(x, t[_PHI + j])
        k[_PHASE + j], k[_NORMALISED + j], t[_MEAN + j] = units(t[_PHI + j]), normalised_units(x), mean_of(x)
    for j in range(TILE):
        phi = t[_PHI + j]
        low = np.float32(np.ceil((t[_T0 + j] - phi) * _PER_TURN))
        high = np.float32(np.floor((t[_T1 + j] - phi) * _PER_TURN))
        t[_T0 + j] = low
        t[_T1 + j] = clamped(high - low + _ONE, _ZERO, np.float32(labels))
    most = 0
    for j in range(n):
        b = np.uint32(nodes[j])
        first[b], count[b] = np.int32(t[_T0 + j]), np.int32(t[_T1 + j])
        most = max(most, count[b])
    for j in range(TILE):
        t[_PHI + j] += _TURN * t[_T0 + j]
    return most


@inline
def apply_prior(t: Any, nodes: Any, n: int, expected: Any) -> None:
    """Move a tile's first candidates to the orders nearest to the absolute phases ``expected`` (h w).

    Slot _MOVE gets the number of orders after the first, -1 where the nearest one is impossible or too far off.
    """
    for j in range(n):
        t[_T0 + j] = expected[np.uint32(nodes[j])]
    for j in range(TILE):
        change = t[_T0 + j] - t[_PHI + j]
        ahead = whole_turns(change)
        good = (ahead >= _ZERO) & (ahead < t[_T1 + j]) & (abs(change - _TURN * ahead) < _MAX_PHASE_CHANGE)
        t[_MOVE + j] = ahead if good else -_ONE
        t[_PHI + j] += _TURN * ahead if good else _ZERO


@inline
def candidate_costs(
    t: Any, k: Any, order: int, columns: Any, linear: bool, correction: Any, extent: Any, descriptors: Any,
    width: int, height: int, axis: int, inv: Any, texture: Any,
) -> None:  # fmt: skip
    """Cost 0 .. about 1.6 (slot _COST) of the candidates ``order`` after the first of a tile of lattice pixels.

    The normalised phase determines the candidate's column: on coloured surfaces the pointwise one is biased. Both
    phases and the texture are compared at its pixel in the other image; COST_UNOBSERVED outside that image or where it
    has no fringes. ``descriptors``, flat, are the other image's; ``linear``: the table ``columns`` is a straight line
    and needs no look-up.
    """
    start, stop = columns[0], columns[0] + columns[1] * np.float32(columns.shape[0] - 3)
    more = _TURN * np.float32(order)
    for j in range(TILE):
        absolute = t[_PHI + j] + more
        with_bias = absolute + t[_BIAS + j]
        inside = (with_bias >= start) & (with_bias <= stop)
        t[_T0 + j] = with_bias if inside else absolute
    count = np.float32(columns.shape[0] - 3)
    per, last = _ONE / columns[1], count - np.float32(1e-3)
    if linear:
        rate = (columns[columns.shape[0] - 1] - columns[2]) / (columns[1] * count)
        for j in range(TILE):
            t[_U + j] = columns[2] + (t[_T0 + j] - start) * rate
    else:
        for j in range(TILE):
            where = clamped((t[_T0 + j] - start) * per, _ZERO, last)
            k[_CELL + j] = np.int32(where)
            t[_FRACTION + j] = where - np.float32(k[_CELL + j])
        for j in range(TILE):
            entry = np.uint32(k[_CELL + j] + 2)
            t[_T1 + j], t[_U + j] = columns[entry], columns[entry + np.uint32(1)]
        for j in range(TILE):
            t[_U + j] = t[_T1 + j] + t[_FRACTION + j] * (t[_U + j] - t[_T1 + j])
    c0, c1, c2 = correction[0], correction[1], correction[2]
    ends, sides = (
        (np.float32(width - 2), np.float32(height - 2))
        if axis == 0
        else (np.float32(height - 2), np.float32(width - 2))
    )
    step, beside = (np.int32(1), np.int32(width)) if axis == 0 else (np.int32(width), np.int32(1))
    for j in range(TILE):
        u = t[_U + j]
        v = t[_R0 + j] + t[_R1 + j] * u
        good = (t[_T0 + j] >= start) & (t[_T0 + j] <= stop) & (v >= -_HALF) & (v <= extent - _HALF)
        t[_COST + j] = _ZERO if good else _COST_OUTSIDE
        u -= c0 + c1 * u + c2 * v
        main = (t[_M0 + j] + t[_M1 + j] * u) / (_ONE + t[_M2 + j] * u)
        side = t[_Q0 + j] + t[_Q1 + j] * main
        t[_VISIBLE + j] = _ONE if (main >= _ONE) & (side >= _ONE) & (main < ends) & (side < sides) else _ZERO
        # Linear along the direction in which the phase grows, the nearest pixel across it.
        main, side = clamped(main, _ONE, ends), clamped(side, _ONE, sides) + _HALF
        cell, row = np.int32(main), np.int32(side)
        k[_CELL + j] = np.int32(cell * step + row * beside)
        t[_FRACTION + j] = main - np.float32(cell)
    ahead = np.uint32(step)
    for j in range(TILE):
        place = np.uint32(k[_CELL + j])
        k[_P0 + j], k[_P1 + j] = descriptors[place], descriptors[place + ahead]
    for j in range(TILE):
        f, p, q = t[_FRACTION + j], k[_P0 + j], k[_P1 + j]
        plain, equal = phase_units(p), normalised_units(p)
        step, step_normalised = np.int32(phase_units(q) - plain), np.int32(normalised_units(q) - equal)
        plain, equal = np.int32(plain - k[_PHASE + j]), np.int32(equal - k[_NORMALISED + j])
        t[_T0 + j] = (np.float32(plain) + f * np.float32(step)) * RADIANS
        t[_T1 + j] = (np.float32(equal) + f * np.float32(step_normalised)) * RADIANS
    for j in range(TILE):
        p, q, f = k[_P0 + j], k[_P1 + j], t[_FRACTION + j]
        plain, equal, mean = t[_T0 + j], t[_T1 + j], t[_MEAN + j]
        other_mean = mean_of(p) + f * (mean_of(q) - mean_of(p))
        cost = _ONE - _HALF * (decay(min(plain * plain * inv, _EIGHT)) + decay(min(equal * equal * inv, _EIGHT)))
        cost += min(texture * abs(mean - other_mean) / (mean + other_mean + _EIGHT), _MOST_TEXTURE)
        visible = (t[_VISIBLE + j] > _ZERO) & (np.int32(p & q & VALID) != 0)
        cost = cost if visible else COST_UNOBSERVED
        t[_COST + j] = cost if t[_COST + j] == _ZERO else _COST_OUTSIDE


@parallel_allocating
def order_limits(k: int, stride: int, along: Any, limits: Any, phases: Any, correction: Any, rays: Any) -> None:
    """The last two numbers of ``rays`` (h, w, RAY) float32, from each ray's range of s; the second < the first: none.

    Args:
        k: number of a row, stride: its distance to the next one.
        along, limits: of :class:`pipeline.geometry.ray_tables.RayTable`.
        phases: absolute phase at each projector coordinate; correction: see
            :mod:`pipeline.reconstruct.column_correction`.
    """
    last, a = phases.shape[0] - 1, k * stride
    for b in range(rays.shape[1]):
        ends = np.empty(2)
        for e in range(2):
            s = limits[e, a, b]
            u = (along[0, a, b] + along[1, a, b] * s) / (1.0 + along[2, a, b] * s)
            ends[e] = u + correction[0] + correction[1] * u + correction[2] * (rays[a, b, 5] + rays[a, b, 6] * u)
        low, high = min(ends[0], ends[1]), max(ends[0], ends[1])
        if high < -0.5 or low > last + 0.5:
            rays[a, b, 7], rays[a, b, 8] = np.float32(0.0), np.float32(-100.0)
            continue
        ends[0], ends[1] = max(low, -0.5), min(high, last + 0.5)
        for e in range(2):
            i = min(max(int(np.floor(ends[e])), 0), last - 1)
            ends[e] = phases[i] + (ends[e] - i) * (phases[i + 1] - phases[i])
        rays[a, b, 7], rays[a, b, 8] = ends[0], ends[1]
