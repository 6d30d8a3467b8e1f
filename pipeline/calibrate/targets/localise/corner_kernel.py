"""The compiled fit of a blurred crossing of two edges to the image around a chessboard's corner.

Model: ``I = P + Q S + sigma^2 grad Q . grad S``, ``S = erf(d1 / (sqrt(2) sigma)) erf(d2 / (sqrt(2) sigma))`` with the
planes P (mean of light and dark), Q (half their difference) and the distances d1, d2 to two lines through the corner.
That is exact for right angles and a Gaussian blur, and for other angles wrong only in a way that is the same on
opposite sides, which does not move the corner.

Parameters: u, v (relative to the start), directions of the two normals, sigma, three of P, three of Q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pipeline.calibrate.targets.localise.gauss_newton_step import add_row, decompose, solve
from pipeline.common.jit import allocating, allocating_linked, linked, serial

PARAMETERS = 11
_N = 11
_LEAST_SIGMA = 0.25
_SLOPE = 0.05
"""How well the slope of Q is known from that of P, as a share of Q over the window."""


@allocating
def fit_corners(
    image: Any,
    starts: Any,
    windows: Any,
    noise: Any,
    blur: Any,
    clip: float,
    steps: int,
    parameters: Any,
    results: Any,
) -> None:
    """Fit every corner.

    Args:
        image: (H, W) float32.
        starts: (n, 2) where to begin.
        windows: (n,) radius of the pixels that are used.
        noise, blur, clip, steps: as :func:`pipeline.calibrate.targets.localise.ellipse_kernel.fit_all`.
        parameters: (n, 11) in and out; on entry the directions and sigma must be set; where both levels (5 and 8) are 0
            they are measured first.
        results: (n, 10) out: as :func:`pipeline.calibrate.targets.localise.ellipse_kernel.fit_all`, with dark for
            inside.
    """
    for i in range(len(starts)):
        _fit(image, starts[i], windows[i], noise, blur, clip, steps, parameters[i], results[i])


@allocating_linked
def _fit(
    image: Any, start: Any, window: float, noise: Any, blur: Any, clip: float, steps: int, p: Any, out: Any
) -> None:
    out[:] = 0.0
    height, width = image.shape
    margin = window + 1.0
    if start[0] < margin or start[1] < margin or start[0] > width - 1 - margin or start[1] > height - 1 - margin:
        return
    if p[5] == 0.0 and p[8] == 0.0:
        _levels(image, start, window, p)
    normal, right, row = np.zeros((_N, _N)), np.zeros(_N), np.zeros(_N)
    small = False
    moved = 1e9
    for step in range(steps + 1):
        if not _normal_equations(image, start, window, noise, blur, clip, p, normal, right, row, out):
            return
        if not decompose(normal, _N):
            return
        if step == steps or small:
            break
        solve(normal, right, _N)
        moved = right[0] * right[0] + right[1] * right[1]
        small = _move(p, right, window)
        if p[0] * p[0] + p[1] * p[1] > 0.25 * window * window + 4.0:
            return
    column = np.zeros(_N)
    for k in range(2):
        column[:] = 0.0
        column[k] = 1.0
        solve(normal, column, _N)
        out[k] = column[k]
        if k == 1:
            out[2] = column[0]
    out[9] = 1.0 if small or moved < 0.1 * (out[0] + out[1]) else 0.0


@serial
def _levels(image: Any, start: Any, window: float, p: Any) -> None:
    """Mean, and half the difference of the quadrants where S is positive and negative."""
    plus = minus = 0.0
    n_plus = n_minus = 0
    reach = int(window)
    u0, v0 = int(np.round(start[0])), int(np.round(start[1]))
    for y in range(-reach, reach + 1):
        for x in range(-reach, reach + 1):
            d1 = x * np.cos(p[2]) + y * np.sin(p[2])
            d2 = x * np.cos(p[3]) + y * np.sin(p[3])
            if min(abs(d1), abs(d2)) < 1.0:
                continue
            if d1 * d2 > 0.0:
                plus += image[v0 + y, u0 + x]
                n_plus += 1
            else:
                minus += image[v0 + y, u0 + x]
                n_minus += 1
    plus, minus = plus / max(n_plus, 1), minus / max(n_minus, 1)
    p[5], p[8] = 0.5 * (plus + minus), 0.5 * (plus - minus)


@linked
def _move(p: Any, step: Any, window: float) -> bool:
    factor = 1.0
    for k in range(2):
        limit = 0.3 * window + 0.5
        if abs(step[k]) * factor > limit:
            factor = limit / abs(step[k])
    for k in range(2, 4):
        if abs(step[k]) * factor > 0.2:
            factor = 0.2 / abs(step[k])
    if abs(step[4]) * factor > 0.4 * p[4]:
        factor = 0.4 * p[4] / abs(step[4])
    for k in range(_N):
        p[k] += factor * step[k]
    p[4] = max(p[4], _LEAST_SIGMA)
    return factor == 1.0 and abs(step[0]) < 1e-3 and abs(step[1]) < 1e-3 and abs(step[4]) < 0.02


@linked
def _normal_equations(
    image: Any,
    start: Any,
    window: float,
    noise: Any,
    blur: Any,
    clip: float,
    p: Any,
    normal: Any,
    right: Any,
    row: Any,
    out: Any,
) -> bool:
    height, width = image.shape
    normal[:, :] = 0.0
    right[:] = 0.0
    out[3:9] = 0.0
    edges = 0.0
    sigma = p[4]
    if p[8] == 0.0:
        return False
    n1x, n1y, n2x, n2y = np.cos(p[2]), np.sin(p[2]), np.cos(p[3]), np.sin(p[3])
    # The window stays where the search began, so that the samples do not change from step to step.
    for v in range(max(0, int(start[1] - window)), min(height, int(start[1] + window) + 2)):
        for u in range(max(0, int(start[0] - window)), min(width, int(start[0] + window) + 2)):
            sx, sy = u - start[0], v - start[1]
            if sx * sx + sy * sy > window * window:
                continue
            x, y = sx - p[0], sy - p[1]
            sx, sy = sx / window, sy / window
            d1, d2 = n1x * x + n1y * y, n2x * x + n2y * y
            e1, e2 = math.erf(d1 / sigma * 0.7071067811865476), math.erf(d2 / sigma * 0.7071067811865476)
            b1 = 0.7978845608028654 / sigma * math.exp(-0.5 * d1 * d1 / (sigma * sigma))
            b2 = 0.7978845608028654 / sigma * math.exp(-0.5 * d2 * d2 / (sigma * sigma))
            shape = e1 * e2
            gx, gy = b1 * n1x * e2 + b2 * n2x * e1, b1 * n1y * e2 + b2 * n2y * e1
            q = p[8] + p[9] * sx + p[10] * sy
            blend = sigma * sigma / window
            model = p[5] + p[6] * sx + p[7] * sy + q * shape + blend * (p[9] * gx + p[10] * gy)
            value = image[v, u]
            if value >= clip and model >= clip:
                continue
            residual = value - model
            row[0], row[1] = -q * gx, -q * gy
            row[2], row[3] = q * b1 * e2 * (n1x * y - n1y * x), q * b2 * e1 * (n2x * y - n2y * x)
            row[4] = -q * (b1 * e2 * d1 + b2 * e1 * d2) / sigma
            row[5], row[6], row[7] = 1.0, sx, sy
            row[8], row[9], row[10] = shape, shape * sx + blend * gx, shape * sy + blend * gy
            weight = 1.0 / (noise[0] + noise[1] * max(model, 0.0))
            add_row(normal, right, row, residual, weight, _N)
            edge_strength = gx * gx + gy * gy
            out[3] += edge_strength * weight * residual * residual
            edges += edge_strength
            out[4] += 1.0
            if abs(shape) > 0.95:
                if q * shape < 0.0:
                    out[5] += residual * residual
                    out[6] += 1.0
                else:
                    out[7] += residual * residual
                    out[8] += 1.0
    if out[4] < _N + 4 or not edges > 0.0:
        return False
    out[3] *= out[4] / (edges * (out[4] - _N))
    row[:] = 0.0
    row[4] = 1.0
    add_row(normal, right, row, blur[0] - sigma, 1.0 / (blur[1] * blur[1]), _N)
    # Light acts on the dark and the light squares alike: the slope of Q is that of P times Q / P.
    k = p[8] / p[5] if p[5] != 0.0 else 0.0
    slope_weight = 1.0 / (_SLOPE * p[8]) ** 2
    for j in range(2):
        row[:] = 0.0
        row[9 + j], row[6 + j] = 1.0, -k
        add_row(normal, right, row, k * p[6 + j] - p[9 + j], slope_weight, _N)
    return True
