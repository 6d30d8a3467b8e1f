"""What is not certain is unknown: local agreement, connected surfaces, and uniqueness in the other two devices."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

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


@parallel
def _cells(known: Any, place: Any, height: int, width: int) -> Any:
    """(H * W) int32 flat index of the other device's pixel, -1 outside or where nothing is known."""
    rows, columns = known.shape
    out = np.full(rows * columns, np.int32(-1))
    for i in prange(rows):
        for j in range(columns):
            if known[i, j]:
                y, x = int(np.floor(place[i, j, 1] + 0.5)), int(np.floor(place[i, j, 0] + 0.5))
                if y >= 0 and x >= 0 and y < height and x < width:
                    out[i * columns + j] = y * width + x
    return out


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
def _claims(cells: Any, depth: Any, n: int) -> tuple[Any, Any]:
    """Nearest and farthest point (flat index, -1 none) of each of the other device's n pixels."""
    near, far = np.full(n, np.int32(-1)), np.full(n, np.int32(-1))
    for k in range(cells.shape[0]):
        c = cells[k]
        if c < 0:
            continue
        if near[c] < 0:
            near[c] = far[c] = k
        elif depth[k] < depth[near[c]]:
            near[c] = k
        elif depth[k] > depth[far[c]]:
            far[c] = k
    return near, far


@serial
def _contested(cells: Any, near: Any, far: Any, value: Any, label: Any, size: Any, tolerance: float) -> Any:
    """Share of each surface's points whose pixel of the other device another surface claims as well, by label."""
    share = np.zeros(size.shape[0], np.float32)
    for k in range(cells.shape[0]):
        c = cells[k]
        if c < 0 or near[c] == far[c]:
            continue
        mine = label[k]
        for rival in (near[c], far[c]):
            if label[rival] != mine and abs(value[rival] - value[k]) > tolerance:
                share[mine] += np.float32(1.0) / size[mine]
                break
    return share


@serial
def _arbitrate(
    known: Any, cells: Any, near: Any, far: Any, value: Any, depth: Any, label: Any, size: Any, share: Any,
    tolerance: float, sure: int,
) -> int:  # fmt: skip
    """Forget the points whose claim does not prevail; all arrays flat. Returns their number."""
    gone = 0
    for k in range(cells.shape[0]):
        c = cells[k]
        if c < 0 or near[c] == far[c]:
            continue
        for rival in (near[c], far[c]):
            if label[rival] == label[k] or abs(value[rival] - value[k]) <= tolerance:
                continue
            if not _prevails(label[k], depth[k], label[rival], depth[rival], size, share, sure):
                known[k] = False
                gone += 1
                break
    return gone


def unique(
    known: NDArray[np.bool_], place: Any, value: Any, depth: Any, label: Any, size: Any, shape: tuple[int, int],
    tolerance: float, sure: int,
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
    cells = _cells(known, place, height, width)
    flat_depth, flat_value, flat_label = depth.ravel(), value.ravel(), label.ravel()
    near, far = _claims(cells, flat_depth, height * width)
    share = _contested(cells, near, far, flat_value, flat_label, size, tolerance)
    return int(
        _arbitrate(
            known.reshape(-1), cells, near, far, flat_value, flat_depth, flat_label, size, share, tolerance, sure
        )
    )
