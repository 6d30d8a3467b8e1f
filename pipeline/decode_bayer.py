"""Decoding of a mosaic: window fit on raw samples, no demosaicing, clipped samples left out."""

from __future__ import annotations

from math import sqrt
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from pipeline.kernels import half_turn, parallel, prange, serial


F32 = NDArray[np.float32]
CONSISTENT = 0.35  # cosine of the largest phase deviation inside a window
AGREEING_ROUGH = 0.2  # see AGREEING of the window fit; the error of a first guess changes from pixel to pixel
_ACROSS = 5



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


def local_means(channels: F32, period_px: float, *, axis: str) -> F32:
    """Two-pass box mean of (H, W, 3) channels over one period along the axis of growth."""
    length = max(3, round(period_px))
    window = (length, _ACROSS) if axis == "x" else (_ACROSS, length)
    once = cv2.blur(channels, window, borderType=cv2.BORDER_REFLECT)
    return np.asarray(cv2.blur(once, window, borderType=cv2.BORDER_REFLECT), dtype=np.float32)


@parallel
def equalized_phasor(channels: Any, means: Any, solve: Any) -> Any:
    """Phasor of the channels divided by their means; ``solve`` (3, 3) gives (A, C, S) without crosstalk.

    Returns:
        (H, W) complex64, about unit size for full modulation.
    """
    height, width = channels.shape[:2]
    out = np.empty((height, width), np.complex64)
    for i in prange(height):
        for j in range(width):
            r = channels[i, j, 0] / max(means[i, j, 0], np.float32(1.0))
            g = channels[i, j, 1] / max(means[i, j, 1], np.float32(1.0))
            b = channels[i, j, 2] / max(means[i, j, 2], np.float32(1.0))
            c = solve[1, 0] * r + solve[1, 1] * g + solve[1, 2] * b
            s = solve[2, 0] * r + solve[2, 1] * g + solve[2, 2] * b
            out[i, j] = complex(c, s)
    return out
