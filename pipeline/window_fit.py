"""Phase from a small window of raw samples: no demosaicing, clipped samples left out.

Within the window the phase is a plane: sample I at offset d from the centre sees phase ``phi + D``, D = grad(phi) . d.
With (a, p, q) of its channel (see :mod:`pipeline.phase`) it obeys
``I = a A + C (p cos D + q sin D) + S (q cos D - p sin D)``: three unknowns, weighted least squares, closed form.
Samples whose phase does not continue the plane (another surface) are left out as well.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.kernels import half_turn, parallel, prange, serial

F32 = NDArray[np.float32]

CONSISTENT = 0.35  # cosine of the largest phase deviation inside a window
AGREEING = 0.85  # cosine of the largest difference of the steps to both sides on one surface
AGREEING_ROUGH = 0.2  # the same for the first guess of a mosaic, whose error changes from pixel to pixel


def weights_of(radius: int, sigma: float) -> F32:
    """(2r+1, 2r+1) Gaussian weights."""
    d = np.arange(-radius, radius + 1)
    g = np.exp(-(d**2) / (2 * sigma**2))
    return np.outer(g, g).astype(np.float32)


@serial
def _step(back: Any, here: Any, ahead: Any, nominal_c: float, nominal_s: float, agreeing: float) -> tuple[float, float]:
    """Phasor of the phase's step by one pixel.

    The central difference where both sides agree; at the border of a surface the side whose step is nearer to the
    expected one (``nominal``), since the other crosses over to another surface.
    """
    fc = ahead.real * here.real + ahead.imag * here.imag
    fs = ahead.imag * here.real - ahead.real * here.imag
    bc = here.real * back.real + here.imag * back.imag
    bs = here.imag * back.real - here.real * back.imag
    f, b = sqrt(fc * fc + fs * fs) + 1e-12, sqrt(bc * bc + bs * bs) + 1e-12
    if fc * bc + fs * bs > agreeing * f * b:
        return half_turn(fc * bc - fs * bs, fc * bs + fs * bc)
    if (fc * nominal_c + fs * nominal_s) * b >= (bc * nominal_c + bs * nominal_s) * f:
        return fc / f, fs / f
    return bc / b, bs / b


@serial
def _slopes(phasor: Any, i: int, j: int, nominal: Any, agreeing: float) -> tuple[float, float, float, float]:
    """Phasors of the phase's steps by one pixel to the right and down; ``nominal`` (4,) the expected ones."""
    here = phasor[i, j]
    cx, sx = _step(phasor[i, j - 1], here, phasor[i, j + 1], nominal[0], nominal[1], agreeing)
    cy, sy = _step(phasor[i - 1, j], here, phasor[i + 1, j], nominal[2], nominal[3], agreeing)
    return cx, sx, cy, sy


@serial
def _turns(cx: float, sx: float, cy: float, sy: float, radius: int, cosines: Any, sines: Any) -> None:
    """Fill cos D and sin D for all offsets of the window."""
    n = 2 * radius + 1
    cosines[radius, radius], sines[radius, radius] = 1.0, 0.0
    for k in range(radius):
        c, s = cosines[radius, radius + k], sines[radius, radius + k]
        cosines[radius, radius + k + 1], sines[radius, radius + k + 1] = c * cx - s * sx, s * cx + c * sx
        cosines[radius, radius - k - 1] = cosines[radius, radius + k + 1]
        sines[radius, radius - k - 1] = -sines[radius, radius + k + 1]
    for k in range(radius):
        for b in range(n):
            c, s = cosines[radius + k, b], sines[radius + k, b]
            cosines[radius + k + 1, b], sines[radius + k + 1, b] = c * cy - s * sy, s * cy + c * sy
            c, s = cosines[radius - k, b], sines[radius - k, b]
            cosines[radius - k - 1, b], sines[radius - k - 1, b] = c * cy + s * sy, s * cy - c * sy


@serial
def _solve(n: Any, q: Any, rhs: Any, out: Any) -> None:
    """Solve the 3x3 symmetric system; out = A, C, S, variance of the angle (negative: singular)."""
    c00 = n[1, 1] * n[2, 2] - n[1, 2] * n[1, 2]
    c01 = n[0, 2] * n[1, 2] - n[0, 1] * n[2, 2]
    c02 = n[0, 1] * n[1, 2] - n[0, 2] * n[1, 1]
    det = n[0, 0] * c00 + n[0, 1] * c01 + n[0, 2] * c02
    scale = n[0, 0] * n[1, 1] * n[2, 2]
    if det <= 1e-3 * scale or scale <= 0.0:
        out[3] = -1.0
        return
    c11 = n[0, 0] * n[2, 2] - n[0, 2] * n[0, 2]
    c12 = n[0, 1] * n[0, 2] - n[0, 0] * n[1, 2]
    c22 = n[0, 0] * n[1, 1] - n[0, 1] * n[0, 1]
    inv = 1.0 / det
    mean = (c00 * rhs[0] + c01 * rhs[1] + c02 * rhs[2]) * inv
    c = (c01 * rhs[0] + c11 * rhs[1] + c12 * rhs[2]) * inv
    s = (c02 * rhs[0] + c12 * rhs[1] + c22 * rhs[2]) * inv
    norm = c * c + s * s + 1e-9
    y0 = (-c01 * s + c02 * c) * inv
    y1 = (-c11 * s + c12 * c) * inv
    y2 = (-c12 * s + c22 * c) * inv
    spread = (
        q[0, 0] * y0 * y0 + q[1, 1] * y1 * y1 + q[2, 2] * y2 * y2
        + 2.0 * (q[0, 1] * y0 * y1 + q[0, 2] * y0 * y2 + q[1, 2] * y1 * y2)
    )  # fmt: skip
    out[0], out[1], out[2], out[3] = mean, c, s, spread / (norm * norm)


@serial
def _add(n: Any, q: Any, rhs: Any, r0: float, r1: float, r2: float, value: float, w: float, variance: float) -> None:
    rhs[0] += w * r0 * value
    rhs[1] += w * r1 * value
    rhs[2] += w * r2 * value
    v = w * w * variance
    n[0, 0] += w * r0 * r0
    n[0, 1] += w * r0 * r1
    n[0, 2] += w * r0 * r2
    n[1, 1] += w * r1 * r1
    n[1, 2] += w * r1 * r2
    n[2, 2] += w * r2 * r2
    q[0, 0] += v * r0 * r0
    q[0, 1] += v * r0 * r1
    q[0, 2] += v * r0 * r2
    q[1, 1] += v * r1 * r1
    q[1, 2] += v * r1 * r2
    q[2, 2] += v * r2 * r2


@serial
def _row_steps(re: Any, im: Any, middle: int, nominal: Any, power_x: Any, power_y: Any) -> None:
    """Phasors of the phase's steps of one row, and their powers, as :func:`_slopes` but for whole rows at once.

    Straight loops over contiguous float32 rows without branches: the compiler turns them into vector instructions.
    ``power_x`` and ``power_y`` (radius + 1, 2, width) get the k-fold turns by one pixel to the right and down.
    """
    width = re.shape[1]
    one, half, tiny = np.float32(1.0), np.float32(0.5), np.float32(1e-12)
    agree = np.float32(AGREEING * AGREEING)
    for direction in range(2):
        out = power_x if direction == 0 else power_y
        nc, ns = nominal[2 * direction], nominal[2 * direction + 1]
        back, ahead, shift = (middle, middle, 1) if direction == 0 else (middle - 1, middle + 1, 0)
        out[0, 0, :] = one
        out[0, 1, :] = np.float32(0.0)
        n = width - 2
        mr, mi = re[middle, 1 : 1 + n], im[middle, 1 : 1 + n]
        pr, pi = re[ahead, 1 + shift : 1 + shift + n], im[ahead, 1 + shift : 1 + shift + n]
        qr, qi = re[back, 1 - shift : 1 - shift + n], im[back, 1 - shift : 1 - shift + n]
        out_c, out_s = out[1, 0, 1 : 1 + n], out[1, 1, 1 : 1 + n]
        for j in range(n):
            hr, hi, ar, ai, br, bi = mr[j], mi[j], pr[j], pi[j], qr[j], qi[j]
            fc, fs = ar * hr + ai * hi, ai * hr - ar * hi
            bc, bs = hr * br + hi * bi, hi * br - hr * bi
            f2, b2 = fc * fc + fs * fs + tiny, bc * bc + bs * bs + tiny
            dot = fc * bc + fs * bs
            c, s = fc * bc - fs * bs, fc * bs + fs * bc
            norm = np.float32(sqrt(c * c + s * s)) + tiny
            root = np.float32(sqrt(max(half * (one + c / norm), np.float32(1e-8))))
            inv_f, inv_b = one / np.float32(sqrt(f2)), one / np.float32(sqrt(b2))
            forward = (fc * nc + fs * ns) * inv_f >= (bc * nc + bs * ns) * inv_b
            side_c = fc * inv_f if forward else bc * inv_b
            side_s = fs * inv_f if forward else bs * inv_b
            smooth = (dot > np.float32(0.0)) & (dot * dot > agree * f2 * b2)
            out_c[j] = root if smooth else side_c
            out_s[j] = half * s / (norm * root) if smooth else side_s
        for k in range(2, out.shape[0]):
            for j in range(width):
                c, s = out[k - 1, 0, j], out[k - 1, 1, j]
                out[k, 0, j] = c * out[1, 0, j] - s * out[1, 1, j]
                out[k, 1, j] = s * out[1, 0, j] + c * out[1, 1, j]


@serial
def _row_sums(
    re: Any, im: Any, mean: Any, tangential: Any, usable: Any, radius: int, weights: Any,
    power_x: Any, power_y: Any, sums: Any,
) -> None:  # fmt: skip
    """Weighted sums over the window of the phasors turned back to the centre, for a whole row; ``sums`` (5, width).

    Rows of ``sums``: weight, C, S, A, variance. Neighbours that do not continue the phase's plane weigh nothing.
    """
    # Slices that all begin at index 0: an index that cannot be negative leaves the loop free of tests.
    n = re.shape[1] - 2 * radius
    sums[:] = np.float32(0.0)
    limit, zero = np.float32(CONSISTENT * CONSISTENT), np.float32(0.0)
    cr, ci = re[radius, radius : radius + n], im[radius, radius : radius + n]
    sum_w, sum_c, sum_s = sums[0, radius : radius + n], sums[1, radius : radius + n], sums[2, radius : radius + n]
    sum_a, sum_v = sums[3, radius : radius + n], sums[4, radius : radius + n]
    for a in range(-radius, radius + 1):
        turn_y = np.float32(1.0 if a >= 0 else -1.0)
        c2, s2 = power_y[abs(a), 0, radius : radius + n], power_y[abs(a), 1, radius : radius + n]
        for b in range(-radius, radius + 1):
            turn_x = np.float32(1.0 if b >= 0 else -1.0)
            weight = weights[a + radius, b + radius]
            c1, s1 = power_x[abs(b), 0, radius : radius + n], power_x[abs(b), 1, radius : radius + n]
            y, o, e = a + radius, radius + b, radius + b + n
            pr, pi, ok, mn, tg = re[y, o:e], im[y, o:e], usable[y, o:e], mean[y, o:e], tangential[y, o:e]
            for j in range(n):
                sx, sy = turn_x * s1[j], turn_y * s2[j]
                cd, sd = c1[j] * c2[j] - sx * sy, sx * c2[j] + c1[j] * sy
                c, s = pr[j] * cd + pi[j] * sd, pi[j] * cd - pr[j] * sd
                dot = c * cr[j] + s * ci[j]
                bound = limit * (c * c + s * s) * (cr[j] * cr[j] + ci[j] * ci[j])
                w = weight * ok[j] if (dot > zero) & (dot * dot >= bound) else zero
                sum_w[j] += w
                sum_c[j] += w * c
                sum_s[j] += w * s
                sum_a[j] += w * mn[j]
                sum_v[j] += w * w * tg[j]


@serial
def _fit_clipped(
    image: Any, i: int, j: int, slopes: Any, rows: Any, black: Any, weights: Any, clip: float, floor: float,
    gain: float, scratch: Any,
) -> None:  # fmt: skip
    """Full normal equations of one pixel from the samples that are not clipped; result in ``scratch[7]``."""
    radius = weights.shape[0] // 2
    cosines, sines = np.empty(weights.shape), np.empty(weights.shape)
    _turns(slopes[0], slopes[1], slopes[2], slopes[3], radius, cosines, sines)
    scratch[:] = 0.0
    n, q, rhs, found = scratch[0:3, :3], scratch[3:6, :3], scratch[6, :3], scratch[7]
    for a in range(-radius, radius + 1):
        for b in range(-radius, radius + 1):
            cd, sd = cosines[a + radius, b + radius], sines[a + radius, b + radius]
            for k in range(3):
                raw = np.float64(image[i + a, j + b, k])
                if raw >= clip:
                    continue
                r1 = rows[k, 1] * cd + rows[k, 2] * sd
                r2 = rows[k, 2] * cd - rows[k, 1] * sd
                _add(n, q, rhs, rows[k, 0], r1, r2, raw - black[k], weights[a + radius, b + radius],
                     floor + gain * max(raw - black[k], 0.0))  # fmt: skip
    _solve(n, q, rhs, found)


@parallel
def fit_three_chip(
    image: Any, phasor: Any, mean: Any, tangential: Any, clipped: Any, rows: Any, black: Any,
    weights: Any, nominal: Any, clip: float, floor: float, gain: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Window fit of a three-chip picture.

    Where no sample of the pixel is clipped the design is the same at every offset and the fit is a weighted mean of
    turned phasors; where one is clipped the full normal equations are solved from the samples that are left.

    Returns:
        phasor (H, W) complex64 and mean (H, W) of the fit; variance of the angle (H, W), rad^2. 0, 0 and inf at the
        border and where too few samples are left.
    """
    height, width = phasor.shape
    radius = weights.shape[0] // 2
    reach = max(radius, 1)
    out = np.zeros((height, width), np.complex64)
    smooth = mean.copy()
    variance = np.full((height, width), np.inf, np.float32)
    for i in prange(reach, height - reach):
        n = 2 * reach + 1
        re, im = np.empty((n, width), np.float32), np.empty((n, width), np.float32)
        usable = np.empty((n, width), np.float32)
        for a in range(n):
            for j in range(width):
                re[a, j], im[a, j] = phasor[i + a - reach, j].real, phasor[i + a - reach, j].imag
                usable[a, j] = np.float32(1.0) if clipped[i + a - reach, j] == 0 else np.float32(0.0)
        power_x = np.zeros((reach + 1, 2, width), np.float32)
        power_y = np.zeros((reach + 1, 2, width), np.float32)
        sums = np.empty((5, width), np.float32)
        _row_steps(re, im, reach, nominal, power_x, power_y)
        o, e = reach - radius, reach + radius + 1
        _row_sums(re[o:e], im[o:e], mean[i - radius : i + radius + 1], tangential[i - radius : i + radius + 1],
                  usable[o:e], radius, weights, power_x, power_y, sums)  # fmt: skip
        scratch, slopes = np.empty((8, 4)), np.empty(4)
        for j in range(reach, width - reach):
            w, c, s = sums[0, j], sums[1, j], sums[2, j]
            if clipped[i, j] == 0:
                if w > np.float32(0.0):
                    smooth[i, j] = sums[3, j] / w
                    out[i, j] = complex(c / w, s / w)
                    variance[i, j] = sums[4, j] / (c * c + s * s + np.float32(1e-9))
                continue
            slopes[0], slopes[1] = power_x[1, 0, j], power_x[1, 1, j]
            slopes[2], slopes[3] = power_y[1, 0, j], power_y[1, 1, j]
            _fit_clipped(image, i, j, slopes, rows, black, weights, clip, floor, gain, scratch)
            if scratch[7, 3] > 0.0:
                smooth[i, j] = min(max(scratch[7, 0], 0.0), 1024.0)
                out[i, j] = complex(scratch[7, 1], scratch[7, 2])
                variance[i, j] = scratch[7, 3]
    return out, smooth, variance


@parallel
def rough_channels(image: Any, mosaic: Any, black: Any, unmix: Any, clip: float) -> tuple[Any, Any]:
    """First guess for a mosaic: each channel's weighted mean over 3 x 3 pixels, black and crosstalk removed.

    Returns:
        channels (H, W, 3) float32, and (H, W) uint8: 1 where the pixel's own sample is clipped.
    """
    height, width = image.shape
    channels = np.zeros((height, width, 3), np.float32)
    clipped = np.zeros((height, width), np.uint8)
    for i in prange(height):
        total, count = np.empty(3), np.empty(3)
        for j in range(width):
            total[:] = 0.0
            count[:] = 0.0
            for a in range(-1, 2):
                for b in range(-1, 2):
                    # Mirrored at the border, which keeps the parity and so the colour.
                    y, x = (i + a, j + b) if 0 < i < height - 1 and 0 < j < width - 1 else (abs(i + a), abs(j + b))
                    y, x = (y if y < height else height - 2), (x if x < width else width - 2)
                    k = mosaic[y & 1, x & 1]
                    w = (2.0 if a == 0 else 1.0) * (2.0 if b == 0 else 1.0)
                    total[k] += w * (image[y, x] - black[k])
                    count[k] += w
            x, y, z = total[0] / count[0], total[1] / count[1], total[2] / count[2]
            for k in range(3):
                channels[i, j, k] = unmix[k, 0] * x + unmix[k, 1] * y + unmix[k, 2] * z
            clipped[i, j] = image[i, j] >= clip
    return channels, clipped


@parallel
def fit_bayer(
    image: Any, mosaic: Any, rough: Any, rough_mean: Any, rows: Any, black: Any, weights: Any, nominal: Any,
    clip: float, floor: float, gain: float,
) -> tuple[Any, Any, Any]:  # fmt: skip
    """Window fit on the raw mosaic; arguments and results as :func:`fit_three_chip`.

    ``rough`` (H, W) complex64 and ``rough_mean`` (H, W) float32 are the first guess; the latter stays where no fit is.
    """
    height, width = image.shape
    radius = weights.shape[0] // 2
    edge = radius + 1
    out = np.zeros((height, width), np.complex64)
    mean = rough_mean.copy()
    variance = np.full((height, width), np.inf, np.float32)
    for i in prange(edge, height - edge):
        cosines, sines = np.empty(weights.shape), np.empty(weights.shape)
        n, q, rhs, found = np.empty((3, 3)), np.empty((3, 3)), np.empty(3), np.empty(4)
        for j in range(edge, width - edge):
            cx, sx, cy, sy = _slopes(rough, i, j, nominal, AGREEING_ROUGH)
            _turns(cx, sx, cy, sy, radius, cosines, sines)
            centre = rough[i, j]
            limit = CONSISTENT * sqrt(centre.real * centre.real + centre.imag * centre.imag)
            n[:] = 0.0
            q[:] = 0.0
            rhs[:] = 0.0
            for a in range(-radius, radius + 1):
                for b in range(-radius, radius + 1):
                    raw = np.float64(image[i + a, j + b])
                    if raw >= clip:
                        continue
                    cd, sd = cosines[a + radius, b + radius], sines[a + radius, b + radius]
                    other = rough[i + a, j + b]
                    c = other.real * cd + other.imag * sd
                    s = other.imag * cd - other.real * sd
                    if c * centre.real + s * centre.imag < limit * sqrt(c * c + s * s):
                        continue
                    k = mosaic[(i + a) & 1, (j + b) & 1]
                    r1 = rows[k, 1] * cd + rows[k, 2] * sd
                    r2 = rows[k, 2] * cd - rows[k, 1] * sd
                    _add(n, q, rhs, rows[k, 0], r1, r2, raw - black[k], weights[a + radius, b + radius],
                         floor + gain * max(raw - black[k], 0.0))  # fmt: skip
            _solve(n, q, rhs, found)
            if found[3] > 0.0:
                mean[i, j] = min(max(found[0], 0.0), 1024.0)
                out[i, j] = complex(found[1], found[2])
                variance[i, j] = found[3]
    return out, mean, variance
