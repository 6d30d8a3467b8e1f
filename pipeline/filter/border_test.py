"""Points at the border of a surface: rejected where they are probably wrong, and given the sigma that they have.

A pixel at a border sees two surfaces, or is fitted from a window that straddles them. Fourteen figures compare it with
the pixels of its own surface around it: neighbours, texture, phase against the projector, modulation, brightness, and
its distance from their plane. A quadratic logistic regression of these gives the probability that the point is wrong,
a linear one of the logarithm the variance of its error. Depths are counted in fringe orders, so that neither the size
of the rig nor its units matter. ``python -m benchmarks.border_model`` fits the coefficients in
:mod:`pipeline.filter.border_model` to simulated images.
"""

from __future__ import annotations

from math import exp, log, sqrt
from typing import Any, NamedTuple

import numpy as np

from pipeline.common.jit import serial
from pipeline.common.parallel_for import parallel
from pipeline.filter.border_model import FIGURES
from pipeline.filter.surface_edges import label_changes
from pipeline.filter.texture_agreement import DEVIATION_STEPS, MISFIT_STEPS
from pipeline.match.match_result import RESIDUAL_STEP

REACH = 2
"""Half width of the neighbourhood that is compared, pixels."""
_NO = np.uint8(0)
_LARGEST_LOG = 9.0


class Planes(NamedTuple):
    """What the figures are computed from; (H, W) unless stated.

    Args:
        label: uint16, one more than the surface, 0 = none; deviation, misfit: of
            :class:`pipeline.filter.texture_agreement.Agreement`; residual_normalised, residual: int16.
        modulation, mean: uint8; xyz, sigma: (stride H, stride W, 3) and (stride H, stride W), mm.
    """

    label: Any
    deviation: Any
    misfit: Any
    residual_normalised: Any
    residual: Any
    modulation: Any
    mean: Any
    xyz: Any
    sigma: Any


@serial
def _figures(p: Any, losses: Any, stride: int, per_order: Any, i: int, j: int, out: Any) -> None:
    """The figures of a pixel into ``out`` (FIGURES,) float64; ``per_order``: change of 1 / z from order to order."""
    height, width = p.label.shape
    k, z0 = p.label[i, j], float(p.xyz[stride * i, stride * j, 2])
    n, beside, loss, modulation, mean, first, second = 0, 0, 0.0, 0.0, 0.0, 0.0, 0.0
    sx, sy, sxx, sxy, syy, sz, sxz, syz, szz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for y in range(max(0, i - REACH), min(height, i + REACH + 1)):
        for x in range(max(0, j - REACH), min(width, j + REACH + 1)):
            if p.label[y, x] != k or (y == i and x == j):
                continue
            n += 1
            beside += abs(y - i) <= 1 and abs(x - j) <= 1
            loss += losses[p.deviation[y, x]]
            modulation += p.modulation[y, x]
            mean += p.mean[y, x]
            first += p.residual_normalised[y, x]
            second += p.residual[y, x]
            dx, dy, dz = float(x - j), float(y - i), float(p.xyz[stride * y, stride * x, 2]) - z0
            sx, sy, sz = sx + dx, sy + dy, sz + dz
            sxx, sxy, syy = sxx + dx * dx, sxy + dx * dy, syy + dy * dy
            sxz, syz, szz = sxz + dx * dz, syz + dy * dz, szz + dz * dz
    orders = 1.0 / (z0 * z0 * per_order)
    sigma = float(p.sigma[stride * i, stride * j]) * orders
    out[2] = min(float(p.deviation[i, j]) / DEVIATION_STEPS, 6.0) / 3.0
    out[9], out[12] = log(sigma + 1e-4), float(p.misfit[i, j]) / MISFIT_STEPS
    out[0], out[1] = beside / 8.0, n / 24.0
    if n == 0:
        out[3], out[4], out[5], out[6], out[7], out[8] = 2.0, 0.5, 2.0, 1.0, 0.0, log(0.31)
        out[10], out[11], out[13] = log(0.005), log(0.005), 2.0
        return
    out[3] = min(loss / n, 3.0)
    out[4] = min(abs(p.residual[i, j] - second / n) * RESIDUAL_STEP, 1.0)
    out[5] = 4.0 * min(abs(p.residual_normalised[i, j] - first / n) * RESIDUAL_STEP, 0.5)
    out[6] = min(p.modulation[i, j] * n / max(modulation, 1.0), 1.2)
    out[7] = min(abs(p.mean[i, j] * n / max(mean, 1.0) - 1.0), 1.0)
    # Plane of the neighbours' depths; the ridge keeps the slopes of few neighbours near 0.
    axx, ayy = sxx + 1.0, syy + 1.0
    c00, c01, c02 = axx * ayy - sxy * sxy, sy * sxy - sx * ayy, sx * sxy - axx * sy
    c11, c12, c22 = n * ayy - sy * sy, sx * sy - n * sxy, n * axx - sx * sx
    inverse = 1.0 / (n * c00 + sx * c01 + sy * c02)
    d = (c00 * sz + c01 * sxz + c02 * syz) * inverse
    u, v = (c01 * sz + c11 * sxz + c12 * syz) * inverse, (c02 * sz + c12 * sxz + c22 * syz) * inverse
    squares = szz - 2.0 * (d * sz + u * sxz + v * syz) + d * d * n + u * u * sxx + v * v * syy
    squares += 2.0 * (d * u * sx + d * v * sy + u * v * sxy)
    out[8] = log(abs(d) * orders + 0.01)
    out[10] = log(sqrt(max(squares, 0.0) / n) * orders + 0.005)
    out[11] = log(sqrt(u * u + v * v) * orders / stride + 0.005)
    out[13] = min(abs(d) * orders / (sigma + 1e-9), 10.0) / 5.0


@serial
def _standardise(mean: Any, scale: Any, x: Any) -> None:
    for k in range(FIGURES):
        x[k] = (x[k] - mean[k]) * scale[k]


@serial
def log_odds(x: Any, wrong: Any) -> float:
    """Logarithm of the odds that a point is wrong: ``wrong`` (1 + n + n (n + 1) / 2,) of standardised figures (n,)."""
    total, m = wrong[0], 1 + FIGURES
    for k in range(FIGURES):
        inner = wrong[1 + k]
        for other in range(k + 1):
            inner += wrong[m] * x[other]
            m += 1
        total += x[k] * inner
    return float(total)


@serial
def log_variance(x: Any, spread: Any) -> float:
    """Logarithm of the variance in units of that of the noise: ``spread`` (1 + 2 n,) of standardised figures (n,)."""
    total = spread[0]
    for k in range(FIGURES):
        total += x[k] * (spread[1 + k] + spread[1 + FIGURES + k] * x[k])
    return float(total)


@parallel
def border_test(
    i: int, planes: Any, losses: Any, stride: int, per_order: Any, model: Any, limit: float, valid: Any, misfit: Any,
    sigma: Any,
) -> None:  # fmt: skip
    """Reject border points that are probably wrong, and give the others the standard deviation of their error.

    Args:
        planes: :class:`Planes`; losses: by deviation; per_order: change of 1 / z from one order to the next, 1 / mm.
        model: :class:`pipeline.filter.border_model.BorderModel`; limit: log odds above which a point is rejected.
        valid: (H, W) uint8, changed; misfit: (H, W) uint8, set to 0 where ``sigma`` (stride H, stride W) is widened.
    """
    height, width = planes.label.shape
    border, x = np.empty(width, np.uint8), np.empty(FIGURES, np.float64)
    label_changes(planes.label[max(i - 1, 0)], planes.label[i], planes.label[min(i + 1, height - 1)], border)
    for j in range(width):
        if border[j] == 0 or valid[i, j] == 0:
            continue
        _figures(planes, losses, stride, per_order, i, j, x)
        _standardise(model.mean, model.scale, x)
        if log_odds(x, model.wrong) > limit:
            valid[i, j] = _NO
            continue
        misfit[i, j] = _NO
        more = min(max(log_variance(x, model.spread), 0.0), _LARGEST_LOG)
        sigma[stride * i, stride * j] *= np.float32(exp(0.5 * more))


@parallel
def border_figures(i: int, planes: Any, losses: Any, stride: int, per_order: Any, out: Any) -> None:
    """The figures of every border pixel, (H, W, FIGURES) float64, NaN elsewhere; what the model is fitted to."""
    height, width = planes.label.shape
    border = np.empty(width, np.uint8)
    label_changes(planes.label[max(i - 1, 0)], planes.label[i], planes.label[min(i + 1, height - 1)], border)
    for j in range(width):
        if border[j] != 0:
            _figures(planes, losses, stride, per_order, i, j, out[i, j])
        else:
            out[i, j, :] = np.nan
