"""Sub-pixel match along the epipolar curve, and the point.

For a left pixel with a known order the right camera must see the same pointwise phase at the image of the point. The
unknown is one number, s, the place on the pixel's viewing ray; a quasi-Newton iteration on the phases finds it.
Because the match is sought along the ray's own epipolar curve, by both full camera models, the four linear
equations of the two views (see :mod:`pipeline.triangulate`) agree there: the point on the ray is their solution.
"""

from __future__ import annotations

from math import atan2, pi, sqrt
from typing import Any

import numpy as np

from pipeline.candidates import column_at, parameter, phase_at, shift_of
from pipeline.kernels import parallel, prange, project, serial

_TWO_PI = 2 * pi
_STEPS = 6
_COHERENCE = 0.4


@serial
def _inside(phasor: Any, x: float, y: float) -> bool:
    height, width = phasor.shape
    return x >= 1.0 and y >= 1.0 and x < width - 2.0 and y < height - 2.0


@serial
def _sample(phasor: Any, x: float, y: float) -> tuple[float, float]:
    """Real and imaginary part of the phasor, bilinear; 0 outside."""
    if not _inside(phasor, x, y):
        return 0.0, 0.0
    i, j = np.uint32(y), np.uint32(x)
    b, a = y - i, x - j
    w00, w01, w10, w11 = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    p00, p01 = phasor[i, j], phasor[i, j + np.uint32(1)]
    p10, p11 = phasor[i + np.uint32(1), j], phasor[i + np.uint32(1), j + np.uint32(1)]
    re = w00 * p00.real + w01 * p01.real + w10 * p10.real + w11 * p11.real
    im = w00 * p00.imag + w01 * p01.imag + w10 * p10.imag + w11 * p11.imag
    return re, im


@serial
def _coherent(phasor: Any, x: float, y: float, re: float, im: float) -> bool:
    """Whether the four neighbours agree in phase with their mean (re, im): else (x, y) lies on a break."""
    i, j = np.uint32(y), np.uint32(x)
    b, a = y - i, x - j
    one = np.uint32(1)
    p00, p01, p10, p11 = phasor[i, j], phasor[i, j + one], phasor[i + one, j], phasor[i + one, j + one]
    # The mean square is at least the square of the mean modulus: a slightly stricter test without four roots.
    square = (
        (1 - a) * (1 - b) * (p00.real * p00.real + p00.imag * p00.imag)
        + a * (1 - b) * (p01.real * p01.real + p01.imag * p01.imag)
        + (1 - a) * b * (p10.real * p10.real + p10.imag * p10.imag)
        + a * b * (p11.real * p11.real + p11.imag * p11.imag)
    )
    return re * re + im * im > _COHERENCE * _COHERENCE * square


@serial
def _angle(c: float, s: float) -> float:
    """Angle of (c, s); a polynomial (Abramowitz and Stegun 4.4.49, error below 2e-8) up to 45 degrees."""
    if not abs(s) < c:
        return atan2(s, c)
    t = s / c
    q = t * t
    p = 0.0429096138 + q * (-0.0161657367 + q * 0.0028662257)
    p = -0.1420889944 + q * (0.1065626393 + q * (-0.0752896400 + q * p))
    return t * (1.0 + q * (-0.3333314528 + q * (0.1999355085 + q * p)))


@serial
def _slope(phasor: Any, x: float, y: float, hx: float, hy: float) -> float:
    """Change of the phase from (x, y) - (hx, hy) to (x, y) + (hx, hy), radians."""
    ar, ai = _sample(phasor, x - hx, y - hy)
    br, bi = _sample(phasor, x + hx, y + hy)
    return _angle(ar * br + ai * bi, ar * bi - ai * br)


@serial
def _coefficients(table: Any, rows: Any, columns: Any, i: int, j: int, out: Any) -> None:
    """Ray table's entry at any pixel, bilinear between lattice pixels (the entries vary smoothly)."""
    dr, dc = rows[1] - rows[0], columns[1] - columns[0]
    y = min(max((i - rows[0]) / dr, 0.0), rows.shape[0] - 1.001)
    x = min(max((j - columns[0]) / dc, 0.0), columns.shape[0] - 1.001)
    a, b = int(y), int(x)
    fy, fx = y - a, x - b
    for k in range(3):
        top = (1 - fx) * table[a, b, k] + fx * table[a, b + 1, k]
        out[k] = (1 - fy) * top + fy * ((1 - fx) * table[a + 1, b, k] + fx * table[a + 1, b + 1, k])


@parallel
def refine(
    order: Any, rows: Any, columns: Any, along: Any, rays: Any, phase: Any, phase_eq: Any, phasor: Any, variance: Any,
    other_phasor: Any, other_variance: Any, device: Any, projector: Any, first_axis: int, base: float, span: float,
    table: Any, phases: Any, correction: Any, floor_sq: float, correlation: float,
) -> tuple[Any, Any, Any, Any, Any]:  # fmt: skip
    """Match and locate every pixel that has an order.

    Args:
        order: (H, W) int16; rays: (H, W, 2) float32 ideal normalised points of the pixels.
        device, projector: packed models of the other camera and the projector.
        base, span: 1/z = base + span s.
        correlation: of neighbouring phases' noise in the other picture (0 pointwise, more after a window fit).

    Returns:
        depth (H, W) float32 mm, NaN where there is no match; sigma (H, W) float32 mm along the ray;
        match (H, W, 2) float32 pixel in the other picture; projector coordinate (H, W, 2) float32 (u, v);
        residual (H, W, 2) float32: absolute phase minus the projector's phase at the point, equalised and pointwise.
    """
    height, width = order.shape
    depth = np.full((height, width), np.float32(np.nan))
    sigma = np.full((height, width), np.float32(np.nan))
    match = np.full((height, width, 2), np.float32(np.nan))
    source = np.full((height, width, 2), np.float32(np.nan))
    residual = np.full((height, width, 2), np.float32(np.nan))
    for i in prange(height):
        c = np.empty(3)
        for j in range(width):
            if order[i, j] == -32768:
                continue
            absolute = phase[i, j] + _TWO_PI * order[i, j]
            bias = phase_eq[i, j] - phase[i, j]
            bias -= _TWO_PI * np.rint(bias / _TWO_PI)
            u = column_at(table, absolute + bias)
            if u != u:
                u = column_at(table, absolute)
            if u != u:
                continue
            _coefficients(along, rows, columns, i, j, c)
            # The term across is small and only the start: the iteration forgets it.
            s = parameter(c, u - shift_of(correction, u, 0.0))
            rx, ry = np.float64(rays[i, j, 0]), np.float64(rays[i, j, 1])
            here = phasor[i, j]
            # Direction of the epipolar curve and the phase's slope along it, once.
            z = 1.0 / (base + span * s)
            x, y = project(device, rx * z, ry * z, z)
            z = 1.0 / (base + span * (s + 0.002))
            x1, y1 = project(device, rx * z, ry * z, z)
            ex, ey = (x1 - x) / 0.002, (y1 - y) / 0.002
            speed = sqrt(ex * ex + ey * ey)
            if not (speed > 1e-6 and speed < 1e7):
                continue
            hx, hy = 0.6 * ex / speed, 0.6 * ey / speed
            slope = _slope(other_phasor, x, y, hx, hy) / 1.2 * speed
            if not abs(slope) > 1e-9:
                continue
            # Iterate on the curve's tangent, then correct once on the curve itself.
            start, x0, y0 = s, x, y
            f = 0.0
            for step in range(_STEPS):
                pr, pi_ = _sample(other_phasor, x, y)
                f = _angle(pr * here.real + pi_ * here.imag, pi_ * here.real - pr * here.imag)
                s -= f / slope
                x, y = x0 + ex * (s - start), y0 + ey * (s - start)
                if abs(f) < 0.01:
                    break
                # Slow convergence means the slope is not that of the surface here: measure it again.
                if step > 0 or abs(f) > 0.5:
                    slope = _slope(other_phasor, x, y, hx, hy) / 1.2 * speed
                    if not abs(slope) > 1e-9:
                        break
            if not abs(f) < 0.1 or not (s > -0.02 and s < 1.02) or abs(s - start) * abs(slope) > 3.0:
                continue
            z = 1.0 / (base + span * s)
            x, y = project(device, rx * z, ry * z, z)
            pr, pi_ = _sample(other_phasor, x, y)
            if pr * pr + pi_ * pi_ < floor_sq or not _coherent(other_phasor, x, y, pr, pi_):
                continue
            f = _angle(pr * here.real + pi_ * here.imag, pi_ * here.real - pr * here.imag)
            s -= f / slope
            z = 1.0 / (base + span * s)
            x, y = x - ex * f / slope, y - ey * f / slope
            if not _inside(other_phasor, x, y):
                continue
            jj, ii = int(x), int(y)
            a, b = x - jj, y - ii
            v = (1 - b) * ((1 - a) * other_variance[ii, jj] + a * other_variance[ii, jj + 1]) + b * (
                (1 - a) * other_variance[ii + 1, jj] + a * other_variance[ii + 1, jj + 1]
            )
            v *= (1 - 2 * a * (1 - a) * (1 - correlation)) * (1 - 2 * b * (1 - b) * (1 - correlation))
            if not v < 1.0:
                continue
            depth[i, j] = z
            match[i, j, 0], match[i, j, 1] = x, y
            pu, pv = project(projector, rx * z, ry * z, z)
            source[i, j, 0], source[i, j, 1] = pu, pv
            p_along, p_across = (pu, pv) if first_axis == 0 else (pv, pu)
            seen = phase_at(phases, p_along + shift_of(correction, p_along, p_across))
            residual[i, j, 0] = absolute + bias - seen
            residual[i, j, 1] = absolute - seen
            ray = sqrt(rx * rx + ry * ry + 1.0)
            sigma[i, j] = sqrt(variance[i, j] + v) / abs(slope) * span * z * z * ray
    return depth, sigma, match, source, residual
