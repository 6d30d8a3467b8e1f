"""Small smooth pieces of the surface, and what the raw pictures say of each of them: the compiled part of the check.

A patch is a rectangle of left pixels about two fringe periods wide. Its points (the cloud's) are projected into the
projector and into the right camera; the projector's phase there, and the right pixels, are fitted by quadratic
polynomials. These are smooth: the noise of single points and whatever ripples within a period are averaged out. Then

*lock-in*: in either camera every raw channel is fitted, by least squares over the raw pixels of its own colour, with
``a + a_x x + a_y y + p cos(Phi) + q sin(Phi)``, Phi from the polynomial. No demosaicing, no interpolation; slopes of
the albedo do not leak into p and q. ``p - i q = B exp(i (r + shift))`` tells the phase r by which the light runs ahead.

*texture*: counts divided by the fitted fringe leave the surface's own brightness, m = sum(I F) / sum(F F) over a 3 x 3
binomial window, in both cameras alike. The right one is looked up where the geometry says that each left pixel's point
is; what differs, minus a plane over the patch (gain and shading), is explained by a displacement (du, dv). The right
gradients hold the same noise as the right brightness, which would bias least squares towards 0: the left gradients,
whose noise is another, are used as instruments.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import inline, project, serial

QUADRATIC = 6
LIGHT = 3
"""Numbers of a channel in a patch: a, p, q."""
TEXTURE = 8
"""Sums of a patch: L_u e, L_v e, L_u R_u, L_u R_v, L_v R_u, L_v R_v, e e, L_v L_v."""
SHAPE = 14
"""Numbers of a patch's shape; see :func:`measure_patches`."""
_EDGE = 2  # pixels around a patch that smoothing and gradients need
_LEAST_KNOWN = 0.85
_LARGEST_ROUGHNESS = 0.2  # rad rms about the polynomial


@serial
def _solved(matrix: Any, right: Any, n: int, columns: int) -> bool:
    """Solve the symmetric positive system in place (Cholesky); False where it is singular."""
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= matrix[i, k] * matrix[j, k]
            if i == j:
                if not total > 1e-9 * max(matrix[i, i], 1e-9):
                    return False
                matrix[i, i] = np.sqrt(total)
            else:
                matrix[i, j] = total / matrix[j, j]
    for c in range(columns):
        for i in range(n):
            total = right[i, c]
            for k in range(i):
                total -= matrix[i, k] * right[k, c]
            right[i, c] = total / matrix[i, i]
        for i in range(n - 1, -1, -1):
            total = right[i, c]
            for k in range(i + 1, n):
                total -= matrix[k, i] * right[k, c]
            right[i, c] = total / matrix[i, i]
    return True


@serial
def _fit_quadratic(points: Any, n: int, u: int, v: int, centre_u: float, centre_v: float, half_u: float,
                   half_v: float, targets: Any, matrix: Any, right: Any) -> bool:  # fmt: skip
    """Least squares of some columns of ``points`` on 1, x, y, x x, x y, y y of columns u and v; into ``right``."""
    matrix[:QUADRATIC, :QUADRATIC] = 0.0
    right[:QUADRATIC, : targets.shape[0]] = 0.0
    b = np.empty(QUADRATIC)
    for k in range(n):
        x, y = (points[k, u] - centre_u) / half_u, (points[k, v] - centre_v) / half_v
        b[0], b[1], b[2], b[3], b[4], b[5] = 1.0, x, y, x * x, x * y, y * y
        for i in range(QUADRATIC):
            for j in range(i + 1):
                matrix[i, j] += b[i] * b[j]
            for c in range(targets.shape[0]):
                right[i, c] += b[i] * points[k, targets[c]]
    return _solved(matrix, right, QUADRATIC, targets.shape[0])


@inline
def _quadratic(q: Any, c: int, x: float, y: float) -> Any:
    return q[0, c] + x * (q[1, c] + x * q[3, c] + y * q[4, c]) + y * (q[2, c] + y * q[5, c])


@serial
def _waves(q: Any, half_u: float, x0: float, y: float, n: int, cosine: Any, sine: Any) -> None:
    """Cosine and sine of the quadratic phase along a row, by recurrence: its second difference is a constant."""
    d = 1.0 / half_u
    start = _quadratic(q, 0, x0, y)
    step = _quadratic(q, 0, x0 + d, y) - start
    bend = 2.0 * q[3, 0] * d * d
    c, s = np.cos(start), np.sin(start)
    tc, ts = np.cos(step), np.sin(step)
    bc, bs = np.cos(bend), np.sin(bend)
    for j in range(n):
        cosine[j], sine[j] = c, s
        c, s = c * tc - s * ts, c * ts + s * tc
        tc, ts = tc * bc - ts * bs, tc * bs + ts * bc


@serial
def _row_sums(values: Any, cosine: Any, sine: Any, first: int, step: int, n: int, x0: float, d: float, y: float,
              normal: Any, sums: Any) -> None:  # fmt: skip
    """Add a row's (or every other of its pixels') part to the equations of one channel.

    Args:
        values, cosine, sine: (n,) float32; x0 + d j: place of pixel j.
        normal: (15,) lower triangle of the normal matrix of 1, x, y, cos, sin, by rows; sums: (5,) right sides.
    """
    zero, one, start, grow = np.float32(0.0), np.float32(1.0), np.float32(x0), np.float32(d)
    m, mx, mxx, si, sxi, sci, ssi = zero, zero, zero, zero, zero, zero, zero
    sc, ss, sxc, sxs, scc, scs = zero, zero, zero, zero, zero, zero
    for j in range(first, n, step):
        x, c, s, i = start + grow * np.float32(j), cosine[j], sine[j], values[j]
        m += one
        mx += x
        mxx += x * x
        sc += c
        ss += s
        sxc += x * c
        sxs += x * s
        scc += c * c
        scs += c * s
        si += i
        sxi += x * i
        sci += c * i
        ssi += s * i
    normal[0] += m
    normal[1] += mx
    normal[2] += mxx
    normal[3] += y * m
    normal[4] += y * mx
    normal[5] += y * y * m
    normal[6] += sc
    normal[7] += sxc
    normal[8] += y * sc
    normal[9] += scc
    normal[10] += ss
    normal[11] += sxs
    normal[12] += y * ss
    normal[13] += scs
    normal[14] += m - scc
    sums[0] += si
    sums[1] += sxi
    sums[2] += y * si
    sums[3] += sci
    sums[4] += ssi


@serial
def _lock_in(picture: Any, mosaic: Any, top: int, left: int, rows: int, columns: int, q: Any, centre_u: float,
             centre_v: float, half_u: float, half_v: float, clip: int, scratch: Any, matrix: Any, right: Any,
             out: Any) -> bool:  # fmt: skip
    """Fit a, p, q of every channel over a rectangle of raw pixels; False when a sample is clipped or a fit singular.

    Every other pair of rows serves (a mosaic repeats after two).

    Args:
        scratch: (5, columns) float32; out: (3, 3) a, p, q by channel, raw counts.
    """
    colours = picture.shape[2]
    cosine, sine = scratch[3], scratch[4]
    normal, sums = np.zeros((3, 15)), np.zeros((3, 5))
    d, x0 = 1.0 / half_u, (left - centre_u) / half_u
    largest = 0
    for i in range(rows):
        if i & 2:
            continue
        v = top + i
        y = (v - centre_v) / half_v
        _waves(q, half_u, x0, y, columns, cosine, sine)
        for j in range(columns):
            for k in range(colours):
                value = picture[v, left + j, k]
                largest = max(largest, value)
                scratch[k, j] = value
        if colours == 3:
            for k in range(3):
                _row_sums(scratch[k], cosine, sine, 0, 1, columns, x0, d, y, normal[k], sums[k])
        else:
            for k in range(2):
                c = mosaic[v & 1, (left + k) & 1]
                _row_sums(scratch[0], cosine, sine, k, 2, columns, x0, d, y, normal[c], sums[c])
    if largest >= clip:
        return False
    for k in range(3):
        for r in range(5):
            right[r, 0] = sums[k, r]
            for s in range(r + 1):
                matrix[r, s] = normal[k, r * (r + 1) // 2 + s]
        if not _solved(matrix, right, 5, 1):
            return False
        out[k, 0], out[k, 1], out[k, 2] = right[0, 0], right[3, 0], right[4, 0]
    return True


@serial
def _brightness(picture: Any, mosaic: Any, black: Any, top: int, left: int, rows: int, columns: int, q: Any,
                centre_u: float, centre_v: float, half_u: float, half_v: float, light: Any, scratch: Any,
                raw: Any, out: Any) -> None:  # fmt: skip
    """Counts over the fitted fringe in a rectangle, smoothed; the outermost pixels of ``out`` stay undefined."""
    colours = picture.shape[2]
    cosine, sine = scratch[3], scratch[4]
    level, p, r, dark = (
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
        np.empty(3, np.float32),
    )
    for c in range(3):
        dark[c], level[c], p[c], r[c] = black[c], light[c, 0] - black[c], light[c, 1], light[c, 2]
    for i in range(rows):
        v = top + i
        _waves(q, half_u, (left - centre_u) / half_u, (v - centre_v) / half_v, columns, cosine, sine)
        over, under = raw[0, i], raw[1, i]
        if colours == 3:
            for j in range(columns):
                a, b = np.float32(0.0), np.float32(0.0)
                for c in range(3):
                    f = level[c] + p[c] * cosine[j] + r[c] * sine[j]
                    a += f * (np.float32(picture[v, left + j, c]) - dark[c])
                    b += f * f
                over[j], under[j] = a, b
        else:
            for j in range(columns):
                c = mosaic[v & 1, (left + j) & 1]
                f = level[c] + p[c] * cosine[j] + r[c] * sine[j]
                over[j], under[j] = f * (np.float32(picture[v, left + j, 0]) - dark[c]), f * f
    two, one = np.float32(2.0), np.float32(1.0)
    a, b = scratch[0], scratch[1]
    for i in range(1, rows - 1):
        for j in range(columns):
            a[j] = raw[0, i - 1, j] + two * raw[0, i, j] + raw[0, i + 1, j]
            b[j] = raw[1, i - 1, j] + two * raw[1, i, j] + raw[1, i + 1, j]
        for j in range(1, columns - 1):
            out[i, j] = (a[j - 1] + two * a[j] + a[j + 1]) / max(b[j - 1] + two * b[j] + b[j + 1], one)


@serial
def _compare(left: Any, right: Any, rows: int, columns: int, q: Any, half_u: float, half_v: float, origin_u: float,
             origin_v: float, right_rows: int, right_columns: int, out: Any) -> bool:  # fmt: skip
    """The sums :data:`TEXTURE` of a patch; False when the right rectangle does not hold it.

    Args:
        left, right: brightness, with :data:`_EDGE` pixels around the patch; q: (6, 3), columns 1 and 2 the right pixel.
    """
    plane, products = np.zeros((3, 5)), np.zeros(TEXTURE)
    f = np.empty(5)
    sx, sy, middle = 0.0, 0.0, (columns - 1) // 2
    for i in range(rows):
        y = (i - 0.5 * (rows - 1)) / half_v
        for j in range(1, columns - 1, 2):
            x = (j - 0.5 * (columns - 1)) / half_u
            ur = _quadratic(q, 1, x, y) - origin_u
            vr = _quadratic(q, 2, x, y) - origin_v
            a, b = int(np.floor(vr)), int(np.floor(ur))
            if a < 2 or b < 2 or a > right_rows - 4 or b > right_columns - 4:
                return False
            fv, fu = vr - a, ur - b
            w00, w01, w10, w11 = (1 - fv) * (1 - fu), (1 - fv) * fu, fv * (1 - fu), fv * fu
            value = w00 * right[a, b] + w01 * right[a, b + 1] + w10 * right[a + 1, b] + w11 * right[a + 1, b + 1]
            ru = 0.5 * (
                w00 * (right[a, b + 1] - right[a, b - 1]) + w01 * (right[a, b + 2] - right[a, b])
                + w10 * (right[a + 1, b + 1] - right[a + 1, b - 1]) + w11 * (right[a + 1, b + 2] - right[a + 1, b])
            )  # fmt: skip
            rv = 0.5 * (
                w00 * (right[a + 1, b] - right[a - 1, b]) + w01 * (right[a + 1, b + 1] - right[a - 1, b + 1])
                + w10 * (right[a + 2, b] - right[a, b]) + w11 * (right[a + 2, b + 1] - right[a, b + 1])
            )  # fmt: skip
            k, m = i + _EDGE, j + _EDGE
            f[0] = left[k, m] - value
            f[1], f[2] = 0.5 * (left[k, m + 1] - left[k, m - 1]), 0.5 * (left[k + 1, m] - left[k - 1, m])
            f[3], f[4] = ru, rv
            across, down = float(j - middle), i - 0.5 * (rows - 1)
            sx += across * across
            sy += down * down
            for c in range(5):
                plane[0, c] += f[c]
                plane[1, c] += across * f[c]
                plane[2, c] += down * f[c]
            products[0] += f[1] * f[0]
            products[1] += f[2] * f[0]
            products[2] += f[1] * f[3]
            products[3] += f[1] * f[4]
            products[4] += f[2] * f[3]
            products[5] += f[2] * f[4]
            products[6] += f[0] * f[0]
            products[7] += f[2] * f[2]
    n = rows * ((columns - 1) // 2)
    pairs = ((1, 0), (2, 0), (1, 3), (1, 4), (2, 3), (2, 4), (0, 0), (2, 2))
    for k in range(TEXTURE):
        c, d = pairs[k]
        # On a rectangle 1, x and y are orthogonal.
        out[k] = products[k] - (
            plane[0, c] * plane[0, d] / n + plane[1, c] * plane[1, d] / sx + plane[2, c] * plane[2, d] / sy
        )
    return True


@serial
def measure_patches(
    left: Any, right: Any, mosaic: Any, black: Any, xyz: Any, origins: Any, columns: int, rows: int, projector: Any,
    other: Any, phases: Any, first: int, clip: int, good: Any, shape: Any, light: Any, texture: Any,
) -> None:  # fmt: skip
    """Everything that single patches tell.

    Args:
        left, right: (H, W, 3) or, for a mosaic, (H, W, 1) uint8; mosaic: (2, 2) channel numbers.
        black: (2, 3) counts, left and right; xyz: (H, W, 3) float32, known at least at pixels with even coordinates.
        origins: (n, 2) even column and row of each patch's first pixel; columns, rows: its size.
        projector, other: packed models; phases: (m,) phase at every projector coordinate.
        first: 0 when it grows along u, else 1.
        clip: counts from which a sample is clipped.
        good: (n,) uint8, bit 1: shape and light are known, bit 2: texture too.
        shape: (n, 14): point x, y, z of the middle; roughness, rad; right pixel u, v; phase slopes of the left picture
            along u and v, of the right one along u and v, rad per pixel; phase per projector coordinate, rad per pixel;
            projector coordinate; share of known points; rms of the texture's difference.
        light: (n, 2, 3, 3) camera, channel, (a, p, q), raw counts.
        texture: (n, 8), see :data:`TEXTURE`.
    """
    height, width = xyz.shape[:2]
    other_height, other_width = right.shape[:2]
    step_u, step_v = 2, 4
    most = ((columns + step_u - 1) // step_u) * ((rows + step_v - 1) // step_v)
    points = np.empty((most, 5))
    matrix, b = np.empty((QUADRATIC, QUADRATIC)), np.empty((QUADRATIC, 3))
    q, q_right = np.empty((QUADRATIC, 3)), np.empty((QUADRATIC, 1))
    targets, single = np.array([2, 3, 4]), np.array([2])
    half_u, half_v = 0.5 * columns, 0.5 * rows
    wide, high = 3 * columns + 8, 2 * rows + 8
    scratch, raw = np.empty((5, wide), np.float32), np.empty((2, high, wide), np.float32)
    bright_left, bright_right = np.empty((high, wide), np.float32), np.empty((high, wide), np.float32)
    for k in range(origins.shape[0]):
        good[k] = 0
        u0, v0 = origins[k, 0], origins[k, 1]
        if u0 < _EDGE or v0 < _EDGE or u0 + columns + _EDGE > width or v0 + rows + _EDGE > height:
            continue
        centre_u, centre_v = u0 + 0.5 * (columns - 1), v0 + 0.5 * (rows - 1)
        n, px, py, pz, pc = 0, 0.0, 0.0, 0.0, 0.0
        for v in range(v0, v0 + rows, step_v):
            for u in range(u0, u0 + columns, step_u):
                z = float(xyz[v, u, 2])
                if not np.isfinite(z):
                    continue
                x, y = float(xyz[v, u, 0]), float(xyz[v, u, 1])
                sent = project(projector, x, y, z)
                seen = project(other, x, y, z)
                column = sent[0] if first == 0 else sent[1]
                c = min(max(int(np.floor(column)), 0), phases.shape[0] - 2)
                points[n, 0], points[n, 1] = u, v
                points[n, 2] = phases[c] + (column - c) * (phases[c + 1] - phases[c])
                points[n, 3], points[n, 4] = seen
                n, px, py, pz, pc = n + 1, px + x, py + y, pz + z, pc + column
        shape[k, 12] = n / most
        if n < _LEAST_KNOWN * most:
            continue
        if not _fit_quadratic(points, n, 0, 1, centre_u, centre_v, half_u, half_v, targets, matrix, q):
            continue
        rough = 0.0
        for i in range(n):
            d = points[i, 2] - _quadratic(q, 0, (points[i, 0] - centre_u) / half_u, (points[i, 1] - centre_v) / half_v)
            rough += d * d
        rough = np.sqrt(rough / n)
        right_u, right_v = q[0, 1], q[0, 2]
        half_right_u, half_right_v = abs(q[1, 1]), abs(q[2, 2])
        if not rough < _LARGEST_ROUGHNESS:
            continue
        if not (0.5 * half_u < half_right_u < 2.0 * half_u and 0.7 * half_v < half_right_v < 1.4 * half_v):
            continue
        if not _fit_quadratic(points, n, 3, 4, right_u, right_v, half_right_u, half_right_v, single, matrix, q_right):
            continue
        left_r, top_r = int(np.ceil(right_u - half_right_u)), int(np.ceil(right_v - half_right_v))
        columns_r, rows_r = int(2 * half_right_u), int(2 * half_right_v)
        if left_r < 0 or top_r < 0 or left_r + columns_r > other_width or top_r + rows_r > other_height:
            continue
        if not _lock_in(left, mosaic, v0, u0, rows, columns, q, centre_u, centre_v, half_u, half_v, clip, scratch,
                        matrix, b, light[k, 0]):  # fmt: skip
            continue
        if not _lock_in(right, mosaic, top_r, left_r, rows_r, columns_r, q_right, right_u, right_v, half_right_u,
                        half_right_v, clip, scratch, matrix, b, light[k, 1]):  # fmt: skip
            continue
        c = min(max(int(np.floor(pc / n)), 0), phases.shape[0] - 2)
        shape[k, 0], shape[k, 1], shape[k, 2], shape[k, 3] = px / n, py / n, pz / n, rough
        shape[k, 4], shape[k, 5] = right_u, right_v
        shape[k, 6], shape[k, 7] = q[1, 0] / half_u, q[2, 0] / half_v
        shape[k, 8], shape[k, 9] = q_right[1, 0] / half_right_u, q_right[2, 0] / half_right_v
        shape[k, 10], shape[k, 11], shape[k, 13] = phases[c + 1] - phases[c], pc / n, 0.0
        good[k] = 1
        extra = _EDGE + 3
        origin_u, origin_v = left_r - extra, top_r - extra
        w, h = min(columns_r + 2 * extra, wide), min(rows_r + 2 * extra, high)
        if origin_u < 0 or origin_v < 0 or origin_u + w > other_width or origin_v + h > other_height:
            continue
        _brightness(left, mosaic, black[0], v0 - _EDGE, u0 - _EDGE, rows + 2 * _EDGE, columns + 2 * _EDGE, q, centre_u,
                    centre_v, half_u, half_v, light[k, 0], scratch, raw, bright_left)  # fmt: skip
        _brightness(right, mosaic, black[1], origin_v, origin_u, h, w, q_right, right_u, right_v, half_right_u,
                    half_right_v, light[k, 1], scratch, raw, bright_right)  # fmt: skip
        if _compare(bright_left, bright_right, rows, columns, q, half_u, half_v, float(origin_u), float(origin_v), h, w,
                    texture[k]):  # fmt: skip
            good[k] = 3
            shape[k, 13] = np.sqrt(max(texture[k, 6], 0.0) / (rows * ((columns - 1) // 2)))
