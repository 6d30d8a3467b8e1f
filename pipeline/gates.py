"""What is not certain is unknown: local agreement, connected surfaces, and uniqueness in the other two devices."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.kernels import parallel, prange, serial


@parallel
def local_outliers(residual: Any, known: Any, limit: float, largest: float, radius: int) -> Any:
    """(H, W) bool: known, a residual is small, and one stays within ``limit`` of its neighbourhood's mean.

    A window that slides along the row keeps the cost independent of its width.
    """
    height, width = known.shape
    good = np.zeros((height, width), np.bool_)
    for i in prange(height):
        top, bottom = max(0, i - radius), min(height, i + radius + 1)
        count = np.zeros(width + 1)
        sums = np.zeros((2, width + 1))
        for j in range(width):
            n, s0, s1 = 0.0, 0.0, 0.0
            for y in range(top, bottom):
                if known[y, j]:
                    n += 1.0
                    s0 += residual[y, j, 0]
                    s1 += residual[y, j, 1]
            count[j + 1] = count[j] + n
            sums[0, j + 1] = sums[0, j] + s0
            sums[1, j + 1] = sums[1, j] + s1
        for j in range(width):
            if not known[i, j]:
                continue
            x0, x1 = max(0, j - radius), min(width, j + radius + 1)
            n = count[x1] - count[x0]
            d0 = abs(residual[i, j, 0] - (sums[0, x1] - sums[0, x0]) / n)
            d1 = abs(residual[i, j, 1] - (sums[1, x1] - sums[1, x0]) / n)
            if min(abs(residual[i, j, 0]), abs(residual[i, j, 1])) > largest:
                continue
            good[i, j] = min(d0, d1) < limit and n >= 0.25 * (bottom - top) * (x1 - x0)
    return good


@serial
def _find(parent: Any, k: int) -> int:
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


@serial
def components(known: Any, absolute: Any, match: Any, slope_x: float, slope_y: float) -> tuple[Any, Any]:
    """Connected surfaces: neighbours whose absolute phase and match continue.

    Returns:
        label (H, W) int32, -1 where unknown; size of each label's surface in pixels (indexed by label).
    """
    height, width = known.shape
    parent = np.arange(height * width).astype(np.int32)
    for i in range(height):
        for j in range(width):
            if not known[i, j]:
                continue
            k = i * width + j
            if j > 0 and known[i, j - 1]:
                step = absolute[i, j] - absolute[i, j - 1] - slope_x
                du = match[i, j, 0] - match[i, j - 1, 0] - 1.0
                dv = match[i, j, 1] - match[i, j - 1, 1]
                if abs(step) < 1.2 and abs(du) < 1.5 and abs(dv) < 1.5:
                    parent[_find(parent, k)] = _find(parent, k - 1)
            if i > 0 and known[i - 1, j]:
                step = absolute[i, j] - absolute[i - 1, j] - slope_y
                du = match[i, j, 0] - match[i - 1, j, 0]
                dv = match[i, j, 1] - match[i - 1, j, 1] - 1.0
                if abs(step) < 1.2 and abs(du) < 1.5 and abs(dv) < 1.5:
                    parent[_find(parent, k)] = _find(parent, k - width)
    label = np.full((height, width), np.int32(-1))
    size = np.zeros(height * width, np.int32)
    for i in range(height):
        for j in range(width):
            if known[i, j]:
                root = _find(parent, i * width + j)
                label[i, j] = root
                size[root] += 1
    return label, size


@serial
def drop_doubtful(known: Any, label: Any, size: Any, residual: Any, smallest: int, largest_rms: float) -> None:
    """Forget surfaces that are too small, or not large and off the projector's phase as a whole.

    A ghost agrees in left and right phase by construction but has no reason to agree with the projector.
    """
    total = np.zeros(size.shape[0], np.float32)
    height, width = known.shape
    for i in range(height):
        for j in range(width):
            if known[i, j]:
                a, b = residual[i, j, 0], residual[i, j, 1]
                total[label[i, j]] += min(a * a, b * b)
    for i in range(height):
        for j in range(width):
            if not known[i, j]:
                continue
            n = size[label[i, j]]
            if n < smallest or (n < 20 * smallest and total[label[i, j]] > largest_rms * largest_rms * n):
                known[i, j] = False


@parallel
def drop_mixed_edges(known: Any, label: Any, modulation: Any, share: float) -> Any:
    """(H, W) bool: known without border pixels whose modulation falls below a share of their surface's next to them.

    At the border of a surface a pixel that sees only half of it, or half in shadow, mixes two phases.
    """
    height, width = known.shape
    out = known.copy()
    for i in prange(height):
        for j in range(width):
            if not known[i, j]:
                continue
            border = i == 0 or j == 0 or i == height - 1 or j == width - 1
            best = 0.0
            for y in range(max(0, i - 1), min(height, i + 2)):
                for x in range(max(0, j - 1), min(width, j + 2)):
                    if known[y, x] and label[y, x] == label[i, j]:
                        best = max(best, float(modulation[y, x]))
                    else:
                        border = True
            if border and modulation[i, j] < share * best:
                out[i, j] = False
    return out


@serial
def _cell(place: Any, i: int, j: int, height: int, width: int) -> tuple[int, int]:
    """Row and column of the other device's pixel, -1 outside."""
    y, x = int(np.rint(place[i, j, 1])), int(np.rint(place[i, j, 0]))
    if y < 0 or x < 0 or y >= height or x >= width:
        return -1, -1
    return y, x


@serial
def _prevails(label: int, depth: float, rival: int, rival_depth: float, size: Any, share: Any, sure: int) -> bool:
    """Whether a claim beats its rival.

    A ghost is contested nearly everywhere, a real surface only where another one hides it; of two established real
    surfaces the nearer hides the other; of small ones the larger is believed.
    """
    a, b = share[label], share[rival]
    if max(a, b) > 0.4 and abs(a - b) > 0.25:
        return a < b
    if size[label] >= sure and size[rival] >= sure:
        return depth < rival_depth
    return size[label] > size[rival]


@serial
def _contested(
    known: Any, place: Any, value: Any, depth: Any, label: Any, size: Any, shape: Any, tolerance: float
) -> Any:
    """Share of each surface's points whose pixel of the other device another surface claims as well, by label."""
    height, width = shape
    near = np.full((height, width), np.int32(-1))
    far = np.full((height, width), np.int32(-1))
    rows, columns = known.shape
    for i in range(rows):
        for j in range(columns):
            if not known[i, j]:
                continue
            y, x = _cell(place, i, j, height, width)
            if y < 0:
                continue
            k = np.int32(i * columns + j)
            if near[y, x] < 0 or depth[i, j] < depth[near[y, x] // columns, near[y, x] % columns]:
                near[y, x] = k
            if far[y, x] < 0 or depth[i, j] > depth[far[y, x] // columns, far[y, x] % columns]:
                far[y, x] = k
    share = np.zeros(size.shape[0], np.float32)
    for i in range(rows):
        for j in range(columns):
            if not known[i, j]:
                continue
            y, x = _cell(place, i, j, height, width)
            if y < 0:
                continue
            for rival in (int(near[y, x]), int(far[y, x])):
                a, b = rival // columns, rival % columns
                if label[a, b] != label[i, j] and abs(value[a, b] - value[i, j]) > tolerance:
                    share[label[i, j]] += np.float32(1.0)
                    break
    for k in range(size.shape[0]):
        if size[k] > 0:
            share[k] /= size[k]
    return share


@serial
def unique(
    known: Any, place: Any, value: Any, depth: Any, label: Any, size: Any, shape: tuple[int, int], tolerance: float,
    sure: int,
) -> int:  # fmt: skip
    """One pixel of another device sees (or lights) one surface only: of two that claim it one is forgotten there.

    Areas seen by the left camera alone can match areas seen by the right alone with perfect phase; nothing else
    removes them.

    Args:
        known: (H, W) bool, changed in place.
        place: (H, W, 2) pixel (u, v) in the other device.
        value: (H, W) what must agree among claimants (absolute phase, or depth parameter).
        depth: (H, W) mm.
        label, size: of the connected surfaces.
        shape: (height, width) of the other device.
        tolerance: largest difference of agreeing values.
        sure: size from which a surface is taken as established, pixels.

    Returns:
        Number of points forgotten.
    """
    height, width = shape
    share = _contested(known, place, value, depth, label, size, shape, tolerance)
    owner = np.full((height, width), np.int32(-1))
    held = np.zeros((height, width), np.float32)
    where = np.zeros((height, width), np.float32)
    for i in range(known.shape[0]):
        for j in range(known.shape[1]):
            if not known[i, j]:
                continue
            y, x = _cell(place, i, j, height, width)
            if y < 0:
                continue
            mine = label[i, j]
            if owner[y, x] < 0 or _prevails(mine, depth[i, j], owner[y, x], where[y, x], size, share, sure):
                owner[y, x] = mine
                held[y, x] = value[i, j]
                where[y, x] = depth[i, j]
    gone = 0
    for i in range(known.shape[0]):
        for j in range(known.shape[1]):
            if not known[i, j]:
                continue
            y, x = _cell(place, i, j, height, width)
            if y >= 0 and owner[y, x] != label[i, j] and abs(held[y, x] - value[i, j]) > tolerance:
                known[i, j] = False
                gone += 1
    return gone
