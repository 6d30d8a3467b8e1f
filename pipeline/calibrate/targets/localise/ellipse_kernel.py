"""The compiled fit of a blurred ellipse to the image around one disc.

Model of the light at x: ``I = P - Q S + sigma phi(d / sigma) n . grad Q`` with the planes P (ground), Q (ground minus
disc), S = Phi(-(d + kappa sigma^2 / 2) / sigma), d the distance to the ellipse along its normal n, kappa its curvature.
That is a sharp ellipse under light that changes linearly, blurred by a Gaussian: for a plane times an indicator s,
``G * (Q s) = Q (G * s) + sigma^2 grad Q . grad (G * s)`` is exact, and the curvature enters to first order (a blurred
disc appears smaller by kappa sigma^2 / 2). The pixels' own aperture adds 1/12 to sigma^2.

Parameters: u, v (relative to the start), E11, E12, E22 (radius matrix), sigma, three of P, three of Q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pipeline.calibrate.targets.localise.gauss_newton_step import add_row, decompose, solve
from pipeline.common.jit import allocating, allocating_linked, linked, serial

PARAMETERS = 12
_N = 12
_LEAST_SIGMA = 0.25
_FAR = 1e-5
_FULL_STEPS = 6
"""From here on steps are halved: samples that enter and leave can make full ones swing."""
_INSIDE_SLOPE = 0.02
"""Prior of the slope of light inside a disc, as a share of the contrast over the radius: shade changes it in
proportion to the ground. It matters only where the pixels of a small disc do not determine the slope."""


@allocating
def fit_all(
    image: Any,
    starts: Any,
    shapes: Any,
    reach: Any,
    noise: Any,
    blur: Any,
    clip: float,
    steps: int,
    parameters: Any,
    results: Any,
) -> None:
    """Fit every disc.

    Args:
        image: (H, W) float32.
        starts, shapes: (n, 2) and (n, 2, 2) where to begin.
        reach: (n,) pixels beyond the edge that may be used.
        noise: (2,) variance of a sample of intensity I is ``noise[0] + noise[1] * max(I, 0)``.
        blur: (2,) prior of sigma: mean and standard deviation, pixels.
        clip: samples from here on are clipped.
        steps: most Gauss-Newton steps.
        parameters: (n, 12) out; where ``parameters[i, 5] > 0`` on entry all twelve are taken as the start.
        results: (n, 10) out: variance of u, of v, covariance; mean squared residual over the expected noise, each
            sample weighted by its information on the edge's position; samples; sum of squared residuals and samples
            inside; the same outside; 1 where the fit converged.
    """
    for i in range(len(starts)):
        _fit(image, starts[i], shapes[i], reach[i], noise, blur, clip, steps, parameters[i], results[i])


@serial
def _begin(image: Any, start: Any, shape: Any, reach: float, p: Any) -> bool:
    """Levels inside and outside; False where the disc is not in the image."""
    height, width = image.shape
    p[0] = p[1] = 0.0
    p[2], p[3], p[4] = shape[0, 0], shape[0, 1], shape[1, 1]
    p[5] = 0.0
    determinant = p[2] * p[4] - p[3] * p[3]
    if not determinant > 0.25:
        return False
    wide = np.sqrt(p[2] * p[2] + p[3] * p[3]) + reach
    tall = np.sqrt(p[4] * p[4] + p[3] * p[3]) + reach
    inside = outside = 0.0
    n_inside = n_outside = 0
    for v in range(max(0, int(start[1] - tall)), min(height, int(start[1] + tall) + 2)):
        for u in range(max(0, int(start[0] - wide)), min(width, int(start[0] + wide) + 2)):
            x, y = u - start[0], v - start[1]
            a, b = (p[4] * x - p[3] * y) / determinant, (p[2] * y - p[3] * x) / determinant
            f = np.sqrt(a * a + b * b)
            if f < 0.6:
                inside += image[v, u]
                n_inside += 1
            elif (
                f > 1.0
                and (f - 1.0) * np.sqrt(determinant) > min(1.5, 0.5 * reach)
                and f < 1.0 + reach / np.sqrt(determinant)
            ):
                outside += image[v, u]
                n_outside += 1
    if n_inside < 1 or n_outside < 6:
        return False
    p[6], p[7], p[8] = outside / n_outside, 0.0, 0.0
    p[9], p[10], p[11] = p[6] - inside / n_inside, 0.0, 0.0
    return True


@allocating_linked
def _fit(
    image: Any, start: Any, shape: Any, reach: float, noise: Any, blur: Any, clip: float, steps: int, p: Any, out: Any
) -> None:
    out[:] = 0.0
    if not p[5] > 0.0:
        if not _begin(image, start, shape, reach, p):
            return
        p[5] = blur[0]
    normal, right, row = np.zeros((_N, _N)), np.zeros(_N), np.zeros(_N)
    small = 0
    moved = 1e9
    for step in range(steps + 1):
        last = step == steps or small >= 1
        if not _normal_equations(image, start, reach, noise, blur, clip, p, normal, right, row, out):
            return
        if not decompose(normal, _N):
            return
        if last:
            break
        solve(normal, right, _N)
        moved = right[0] * right[0] + right[1] * right[1]
        small = 1 if _move(p, right, 1.0 if step < _FULL_STEPS else 0.5) else 0
    column = np.zeros(_N)
    for k in range(2):
        column[:] = 0.0
        column[k] = 1.0
        solve(normal, column, _N)
        out[k] = column[k]
        if k == 1:
            out[2] = column[0]
    # On few pixels the steps may never vanish, because samples enter and leave; far below the noise they are harmless.
    out[9] = 1.0 if small or moved < 0.1 * (out[0] + out[1]) else 0.0


@linked
def _move(p: Any, step: Any, most: float) -> bool:
    """Take a share ``most`` of a step, less where it is too large; return whether it was negligible."""
    radius = np.sqrt(p[2] * p[4] - p[3] * p[3])
    factor = most
    for k in range(5):
        limit = 0.25 * radius + 0.2
        if abs(step[k]) * factor > limit:
            factor = limit / abs(step[k])
    if abs(step[5]) * factor > 0.4 * p[5]:
        factor = 0.4 * p[5] / abs(step[5])
    for k in range(_N):
        p[k] += factor * step[k]
    p[5] = max(p[5], _LEAST_SIGMA)
    centre_converged = factor == most and abs(step[0]) < 2e-3 and abs(step[1]) < 2e-3 and abs(step[5]) < 0.02
    return centre_converged and abs(step[2]) + abs(step[3]) + abs(step[4]) < 0.02


@allocating_linked
def _normal_equations(
    image: Any,
    start: Any,
    reach: float,
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
    ground = np.zeros(6)
    determinant = p[2] * p[4] - p[3] * p[3]
    if not determinant > 0.25 or not (p[2] > 0.0 and p[4] > 0.0) or p[9] == 0.0:
        return False
    radius = np.sqrt(determinant)
    sigma = p[5]
    outward = min(reach, 5.0 * sigma + 2.0)
    inward = 6.0 * sigma + 3.0
    wide, tall = np.sqrt(p[2] * p[2] + p[3] * p[3]) + outward, np.sqrt(p[4] * p[4] + p[3] * p[3]) + outward
    left, right_end = max(0, int(start[0] + p[0] - wide)), min(width, int(start[0] + p[0] + wide) + 2)
    top, bottom = max(0, int(start[1] + p[1] - tall)), min(height, int(start[1] + p[1] + tall) + 2)
    for v in range(top, bottom):
        for u in range(left, right_end):
            x, y = u - start[0] - p[0], v - start[1] - p[1]
            a, b = (p[4] * x - p[3] * y) / determinant, (p[2] * y - p[3] * x) / determinant
            f = np.sqrt(a * a + b * b)
            if f < 0.05:
                d = -radius
                g = 1.0 / radius
                nx = ny = wx = wy = kappa = 0.0
            else:
                gx, gy = (p[4] * a - p[3] * b) / determinant, (p[2] * b - p[3] * a) / determinant
                g = np.sqrt(gx * gx + gy * gy)
                d = (f - 1.0) * f / g
                nx, ny, wx, wy = gx / g, gy / g, a / f, b / f
                kappa = f * f * f / (determinant * determinant * g * g * g)
            if d > outward or d < -inward:
                continue
            z = (d + 0.5 * kappa * sigma * sigma) / sigma
            if z > 7.0:
                share, bell = 0.0, 0.0
            elif z < -7.0:
                share, bell = 1.0, 0.0
            else:
                share, bell = 0.5 * math.erfc(z * 0.7071067811865476), 0.3989422804014327 * math.exp(-0.5 * z * z)
            sx, sy = (u - start[0]) / radius, (v - start[1]) / radius
            q = p[9] + p[10] * sx + p[11] * sy
            model = p[6] + p[7] * sx + p[8] * sy - q * share + sigma * bell * (nx * p[10] + ny * p[11]) / radius
            value = image[v, u]
            if value >= clip and model >= clip:
                continue
            residual = value - model
            # dI/dd = Q phi / sigma; the edge moves by n . (dc + dE w).
            edge = -q * bell / sigma
            weight = 1.0 / (noise[0] + noise[1] * max(model, 0.0))
            out[4] += 1.0
            if share > 0.98:
                out[5] += residual * residual
                out[6] += 1.0
            elif share < 0.02:
                out[7] += residual * residual
                out[8] += 1.0
            if bell < _FAR and share < 0.5:
                # Ground alone: three parameters, most of the samples.
                ground[0] += weight
                ground[1] += weight * sx
                ground[2] += weight * sy
                ground[3] += weight * sx * sx
                ground[4] += weight * sx * sy
                ground[5] += weight * sy * sy
                right[6] += weight * residual
                right[7] += weight * residual * sx
                right[8] += weight * residual * sy
                continue
            row[0], row[1] = edge * nx, edge * ny
            row[2], row[3], row[4] = edge * nx * wx, edge * (nx * wy + ny * wx), edge * ny * wy
            row[5] = q * bell * (0.5 * kappa - d / (sigma * sigma))
            row[6], row[7], row[8] = 1.0, sx, sy
            row[9] = -share
            row[10] = -share * sx + sigma * bell * nx / radius
            row[11] = -share * sy + sigma * bell * ny / radius
            add_row(normal, right, row, residual, weight, _N)
            out[3] += bell * bell * weight * residual * residual
            edges += bell * bell
    normal[6, 6] += ground[0]
    normal[7, 6] += ground[1]
    normal[8, 6] += ground[2]
    normal[7, 7] += ground[3]
    normal[8, 7] += ground[4]
    normal[8, 8] += ground[5]
    if out[4] < _N + 4 or not edges > 0.0:
        return False
    out[3] *= out[4] / (edges * (out[4] - _N))
    row[:] = 0.0
    row[5] = 1.0
    add_row(normal, right, row, blur[0] - sigma, 1.0 / (blur[1] * blur[1]), _N)
    # Shade acts on disc and ground alike: the slope of Q is that of P times Q / P.
    k = p[9] / p[6] if p[6] != 0.0 else 0.0
    slope_weight = 1.0 / (_INSIDE_SLOPE * p[9]) ** 2
    for j in range(2):
        row[:] = 0.0
        row[10 + j], row[7 + j] = 1.0, -k
        add_row(normal, right, row, k * p[7 + j] - p[10 + j], slope_weight, _N)
    return True
