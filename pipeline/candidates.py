"""Every fringe order a lattice pixel may have, with what the pictures say against each.

A wrapped phase phi leaves the absolute phases phi + 2 pi k. Each is a projector column, which meets the pixel's viewing
ray at one point; the other camera must see the same phase at that point's image. On a plane, a candidate wrong by m
periods leaves a residual of 2 pi frac(m rho), rho = baseline left-right over baseline left-projector.
"""

from __future__ import annotations

from math import exp, floor, pi, sqrt
from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial

UNSEEN = 0.5
_TWO_PI = 2 * pi


@serial
def column_at(table: Any, phase: float) -> float:
    """Projector coordinate of an absolute phase; ``table`` holds (first phase, step, columns ...) on an even grid."""
    where = (phase - table[0]) / table[1]
    last = table.shape[0] - 3
    if where < 0.0 or where > last:
        return np.nan
    i = min(int(where), last - 1)
    return table[2 + i] + (where - i) * (table[3 + i] - table[2 + i])


@serial
def phase_at(phases: Any, column: float) -> float:
    """Absolute phase of a projector coordinate by the pattern's own table (value at each column's centre)."""
    last = phases.shape[0] - 1
    i = min(max(floor(column), 0), last - 1)
    return phases[i] + (column - i) * (phases[i + 1] - phases[i])


@serial
def ratio(c: Any, s: float) -> float:
    """Value of a ray table's entry at s."""
    return (c[0] + c[1] * s) / (1.0 + c[2] * s)


@serial
def parameter(c: Any, value: float) -> float:
    """S at which a ray table's entry takes the value."""
    return (value - c[0]) / (c[1] - c[2] * value)


@serial
def shift_of(correction: Any, along: float, across: float) -> float:
    """Observed minus calibrated projector coordinate (affine, from self-calibration), projector pixels."""
    return correction[0] + correction[1] * along + correction[2] * across


@serial
def first_order(along: Any, limits: Any, phi: float, phases: Any, correction: Any, across: float) -> tuple[int, int]:
    """First order and number of orders whose projector coordinate lies in the volume."""
    u0, u1 = ratio(along, limits[0]), ratio(along, limits[1])
    low, high = min(u0, u1), max(u0, u1)
    low += shift_of(correction, low, across)
    high += shift_of(correction, high, across)
    last = phases.shape[0] - 1
    if high < -0.5 or low > last + 0.5:
        return 0, 0
    start = phase_at(phases, max(low, -0.5))
    stop = phase_at(phases, min(high, last + 0.5))
    k0 = int(np.ceil((start - phi) / _TWO_PI))
    k1 = int(np.floor((stop - phi) / _TWO_PI))
    return k0, max(0, k1 - k0 + 1)


@serial
def cost_at(
    x: float, y: float, phasor: Any, equalized: Any, mean: Any, here: Any, here_eq: Any, here_mean: float,
    floor_sq: float, inv_two_var: float, texture: float, slope_x: float, slope_y: float,
) -> float:  # fmt: skip
    """Cost 0 .. about 1.6 of seeing this pixel at (x, y) of the other picture; UNSEEN outside or without fringes."""
    height, width = mean.shape
    if not (x >= 1.0 and y >= 1.0 and x < width - 2.0 and y < height - 2.0):
        return UNSEEN
    # Linear along the direction in which the phase grows, the nearest pixel across it.
    if abs(slope_x) >= abs(slope_y):
        i, j, di, dj = int(y + 0.5), int(x), 0, 1
        a = x - j
    else:
        i, j, di, dj = int(y), int(x + 0.5), 1, 0
        a = y - i
    p = (1 - a) * phasor[i, j] + a * phasor[i + di, j + dj]
    if not p.real * p.real + p.imag * p.imag >= floor_sq:
        return UNSEEN
    e = (1 - a) * equalized[i, j] + a * equalized[i + di, j + dj]
    m = (1 - a) * mean[i, j] + a * mean[i + di, j + dj]
    # 2 (1 - cos d) is d^2 for small differences d, and saves the angle.
    size = sqrt((p.real * p.real + p.imag * p.imag) * (here.real * here.real + here.imag * here.imag)) + 1e-12
    plain = 2.0 - 2.0 * (here.real * p.real + here.imag * p.imag) / size
    size = sqrt((e.real * e.real + e.imag * e.imag) * (here_eq.real * here_eq.real + here_eq.imag * here_eq.imag))
    equal = 2.0 - 2.0 * (here_eq.real * e.real + here_eq.imag * e.imag) / (size + 1e-12)
    phase = 1.0 - 0.5 * (exp(-plain * inv_two_var) + exp(-equal * inv_two_var))
    return phase + texture * min(abs(here_mean - m) / (here_mean + m + 8.0), 0.4)


@parallel
def candidate_costs(
    rows: Any, columns: Any, along: Any, across: Any, other_u: Any, other_v: Any, limits: Any,
    phasor: Any, equalized: Any, mean: Any, valid: Any, phase: Any, phase_eq: Any,
    other_phasor: Any, other_equalized: Any, other_mean: Any,
    table: Any, phases: Any, correction: Any, extent: float, labels: int,
    floor_sq: float, cost_sigma: float, texture: float, slope_x: float, slope_y: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Costs of all candidates of all lattice pixels.

    Two positions are tried for a candidate, that of the pointwise and that of the equalised phase, because either may
    be biased (see :mod:`pipeline.equalize`): each is compared with the same kind in the other picture.

    Returns:
        costs (h, w, labels) float32, large where there is no such candidate; first order (h, w) int16;
        number of candidates (h, w) int16, 0 where the pixel is unknown.
    """
    h, w = rows.shape[0], columns.shape[0]
    costs = np.full((h, w, labels), np.float32(4.0))
    first = np.zeros((h, w), np.int16)
    count = np.zeros((h, w), np.int16)
    inv = 1.0 / (2.0 * cost_sigma * cost_sigma)
    for a in prange(h):
        i = rows[a]
        for b in range(w):
            j = columns[b]
            if not valid[i, j]:
                continue
            p, e = phasor[i, j], equalized[i, j]
            phi, phi_e = phase[i, j], phase_eq[i, j]
            bias = phi_e - phi
            bias -= _TWO_PI * np.rint(bias / _TWO_PI)
            row = ratio(across[a, b], 0.5)
            k0, n = first_order(along[a, b], limits[a, b], phi, phases, correction, row)
            n = min(n, labels)
            first[a, b], count[a, b] = k0, n
            for k in range(n):
                absolute = phi + _TWO_PI * (k0 + k)
                costs[a, b, k] = candidate_cost(
                    absolute, absolute + bias, along[a, b], across[a, b], other_u[a, b], other_v[a, b], p, e,
                    mean[i, j], other_phasor, other_equalized, other_mean, table, correction, extent, row,
                    floor_sq, inv, texture, slope_x, slope_y,
                )  # fmt: skip
    return costs, first, count


@serial
def candidate_cost(
    absolute: float, absolute_eq: float, along: Any, across: Any, other_u: Any, other_v: Any, here: Any, here_eq: Any,
    here_mean: float, other_phasor: Any, other_equalized: Any, other_mean: Any, table: Any, correction: Any,
    extent: float, row: float, floor_sq: float, inv: float, texture: float,
    slope_x: float, slope_y: float,
) -> float:  # fmt: skip
    """Cost of one absolute phase of one pixel."""
    # The equalised phase places the candidate: it is the one whose column can be trusted on coloured surfaces.
    u = column_at(table, absolute_eq)
    if u != u:
        u = column_at(table, absolute)
    if u != u:
        return 4.0
    s = parameter(along, u - shift_of(correction, u, row))
    v = ratio(across, s)
    if v < -0.5 or v > extent - 0.5:
        return 4.0
    return cost_at(
        ratio(other_u, s), ratio(other_v, s), other_phasor, other_equalized, other_mean, here, here_eq, here_mean,
        floor_sq, inv, texture, slope_x, slope_y,
    )  # fmt: skip
