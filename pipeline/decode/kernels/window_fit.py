"""Phase from a small window: the mean of its phasors, rotated back to the centre.

Within the window the phase is a plane. A neighbour one pixel to the right is one step of the phase ahead: rotated back
by the phasor of that step it equals the centre, and the weighted mean of all has less noise without blurring the
fringes. Gaussian weights and the rotation are separable: first along the rows, then across them. Neighbours whose phase
does not continue the plane (another surface), saturated ones, and those beyond the image's end have weight 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.common.jit import inline, linked

F32 = NDArray[np.float32]

CONSISTENT = 0.1  # cosine of the largest phase deviation from one pixel of the window to the next
AGREEING = 0.85  # cosine of the largest difference of the steps to both sides on one surface
# 1 / sqrt(4 - 2 x) for 0 <= x <= 1 - AGREEING, within 1e-7: a root and a division would take as long as all the rest.
_N0, _N1, _N2, _N3 = np.float32(0.49999993), np.float32(0.12500952), np.float32(0.04659383), np.float32(0.02235657)


def weights_of(radius: int, sigma: float) -> F32:
    """(2r+1, 2r+1) Gaussian weights."""
    d = np.arange(-radius, radius + 1)
    g = np.exp(-(d**2) / (2 * sigma**2))
    return np.outer(g, g).astype(np.float32)


@inline
def step_of(
    back_re: float, back_im: float, re: float, im: float, ahead_re: float, ahead_im: float,
    nominal_c: float, nominal_s: float, agreeing: float,
) -> Any:  # fmt: skip
    """Phasor of the phase's step by one pixel, from the unit phasors of a pixel and of its neighbours on both sides.

    The central difference where both sides agree (``agreeing`` is AGREEING or more); at the border of a surface the
    side whose step is nearer to the expected one (``nominal``), since the other leads to another surface.

    Returns:
        cosine and sine of the step; 1 where the neighbour behind continues the plane, else 0; the same ahead.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    fc, fs = ahead_re * re + ahead_im * im, ahead_im * re - ahead_re * im
    bc, bs = re * back_re + im * back_im, im * back_re - re * back_im
    dot = fc * bc + fs * bs
    forward = fc * nominal_c + fs * nominal_s >= bc * nominal_c + bs * nominal_s
    smooth = dot > agreeing
    # The sum of two unit phasors bisects the angle between them, and its length follows from that angle.
    apart = one - dot
    norm = _N0 + apart * (_N1 + apart * (_N2 + apart * _N3))
    c, s = (
        (fc + bc) * norm if smooth else (fc if forward else bc),
        (fs + bs) * norm if smooth else (fs if forward else bs),
    )
    both = dot >= np.float32(CONSISTENT)
    return c, s, one if both | (not forward) else zero, one if both | forward else zero


@linked
def continue_ends(
    re: Any, im: Any, first: int, last: int, count: int, nominal_c: float, nominal_s: float, agreeing: float
) -> None:
    """Unit phasors of ``count`` pixels before ``first`` and after ``last``: the plane of the next three pixels."""
    for end, inwards, s0 in ((first, 1, nominal_s), (last, -1, -nominal_s)):
        a, b = end + inwards, end + 2 * inwards
        c, s, _, _ = step_of(re[end], im[end], re[a], im[a], re[b], im[b], nominal_c, s0, agreeing)
        for k in range(count):
            here = end - k * inwards
            x, y = re[here], im[here]
            re[here - inwards], im[here - inwards] = x * c + y * s, y * c - x * s


@linked
def continue_row(unit_re0: Any, unit_im0: Any, unit_re1: Any, unit_im1: Any, re: Any, im: Any) -> None:
    """Unit phasors (n,) of the row beyond row 0: the plane of that row and of row 1 on its other side."""
    for j in range(re.shape[0]):
        x, y, p, q = unit_re0[j], unit_im0[j], unit_re1[j], unit_im1[j]
        c, s = x * p + y * q, y * p - x * q
        re[j], im[j] = x * c - y * s, y * c + x * s


@linked
def fold(
    unit_re0: Any, unit_im0: Any, unit_re1: Any, unit_im1: Any, unit_re2: Any, unit_im2: Any,
    w0: Any, c0: Any, s0: Any, a0: Any, v0: Any, w1: Any, c1: Any, s1: Any, a1: Any, v1: Any,
    w2: Any, c2: Any, s2: Any, a2: Any, v2: Any,
    nominal_c: float, nominal_s: float, weight: float,
    sum_w: Any, sum_c: Any, sum_s: Any, sum_a: Any, sum_v: Any,
) -> None:  # fmt: skip
    """Weighted sums over the pixels of a row (1) and their neighbours behind (0) and ahead (2) in one direction.

    Args:
        unit_re0 ... unit_im2: (n,) float32, unit phasors.
        w0 ... v2: (n,) float32, sums so far: weight, C, S, A, and variance (by squared weights).
        nominal_c, nominal_s: expected step, unit phasor; weight: of the neighbours, the pixel itself having 1.
        sum_w ... sum_v: results; neighbours are rotated back by the step, excluded if they do not continue the plane.
    """
    for j in range(sum_w.shape[0]):
        tc, ts, back, ahead = step_of(
            unit_re0[j], unit_im0[j], unit_re1[j], unit_im1[j], unit_re2[j], unit_im2[j], nominal_c, nominal_s,
            np.float32(AGREEING),
        )  # fmt: skip
        back *= weight
        ahead *= weight
        c, s, p, q = c0[j], s0[j], c2[j], s2[j]
        sum_w[j] = w1[j] + back * w0[j] + ahead * w2[j]
        sum_c[j] = c1[j] + back * (c * tc - s * ts) + ahead * (p * tc + q * ts)
        sum_s[j] = s1[j] + back * (s * tc + c * ts) + ahead * (q * tc - p * ts)
        sum_a[j] = a1[j] + back * a0[j] + ahead * a2[j]
        sum_v[j] = v1[j] + back * back * v0[j] + ahead * ahead * v2[j]


@linked
def fold_far(
    unit_re0: Any, unit_im0: Any, unit_re1: Any, unit_im1: Any, unit_re2: Any, unit_im2: Any,
    far_re0: Any, far_im0: Any, far_re2: Any, far_im2: Any,
    w0: Any, c0: Any, s0: Any, a0: Any, v0: Any, w2: Any, c2: Any, s2: Any, a2: Any, v2: Any,
    nominal_c: float, nominal_s: float, weight: float,
    sum_w: Any, sum_c: Any, sum_s: Any, sum_a: Any, sum_v: Any,
) -> None:  # fmt: skip
    """Add the neighbours at a distance of two (``far``, 0 behind, 2 ahead) to the sums; otherwise as :func:`fold`."""
    zero, least = np.float32(0.0), np.float32(CONSISTENT)
    for j in range(sum_w.shape[0]):
        re, im = unit_re1[j], unit_im1[j]
        c, s, _, _ = step_of(
            unit_re0[j], unit_im0[j], re, im, unit_re2[j], unit_im2[j], nominal_c, nominal_s, np.float32(AGREEING)
        )
        tc, ts = c * c - s * s, s * c + c * s
        hc, hs = re * tc + im * ts, im * tc - re * ts
        back = weight if hc * far_re0[j] + hs * far_im0[j] >= least else zero
        hc, hs = re * tc - im * ts, im * tc + re * ts
        ahead = weight if hc * far_re2[j] + hs * far_im2[j] >= least else zero
        c, s, p, q = c0[j], s0[j], c2[j], s2[j]
        sum_w[j] += back * w0[j] + ahead * w2[j]
        sum_c[j] += back * (c * tc - s * ts) + ahead * (p * tc + q * ts)
        sum_s[j] += back * (s * tc + c * ts) + ahead * (q * tc - p * ts)
        sum_a[j] += back * a0[j] + ahead * a2[j]
        sum_v[j] += back * back * v0[j] + ahead * ahead * v2[j]
