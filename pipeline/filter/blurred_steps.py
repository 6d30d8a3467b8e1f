"""Points on a step between two surfaces that windows and lens have blurred.

Where a step is less than a quarter of a fringe order, the windows of the phase see both sides as one surface and make
a slope of a few pixels of it. The points on it lie on neither surface. They are known by their neighbours: along a row
or a column the depth passes from one level to another, steeply and in one direction, and on both sides it is flat, 3 to
4 pixels away. Filters of laser scanners remove such points as mixed pixels.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import linked

STEEP = 4.0
"""Tangent of the slope from which a point may lie on a step."""
FLAT = 8.0
"""How many times as steep as the surfaces on both sides the slope is."""
BETWEEN = np.float32(0.2)
"""Share of the depth's change from the neighbour before to the one after that is on either side of the point."""
_ZERO = np.float32(0.0)
_FLAT = np.float32(2 * FLAT)


def least_step(focal_px: float, stride: int) -> np.float32:
    """Change of the depth from the neighbour before to the one after from which both are on a step, by depth."""
    return np.float32(2 * STEEP * stride / focal_px)


@linked
def _along(z: Any, before: Any, after: Any, sides: Any, least: Any, half_order: Any, out: Any) -> None:
    """Set ``out`` (W,) where the depth passes a step at a point; NaN passes none.

    Args:
        z: (W,) depth; before, after: of the neighbours; least: of :func:`least_step`.
        half_order: change of 1 / z by half a fringe order, 1 / mm: where the depth changes by more, no phases mix.
        sides: depths 3 and 4 pixels before, and as many after, four rows (W,).
    """
    near0, far0, near1, far1 = sides
    for j in range(out.shape[0]):
        first, second, across = z[j] - before[j], after[j] - z[j], abs(after[j] - before[j])
        flat = (_FLAT * abs(far0[j] - near0[j]) < across) & (_FLAT * abs(far1[j] - near1[j]) < across)
        between = (first * second > _ZERO) & (min(abs(first), abs(second)) > BETWEEN * across)
        out[j] |= np.uint8(flat & between & (across > least * z[j]) & (across <= half_order * z[j] * z[j]))


@linked
def steps_of_row(depth: Any, k: int, border: int, least_x: Any, least_y: Any, half_order: Any, out: Any) -> None:
    """1 where a point of row k of ``depth``, which has a border of unknown points, is on a step, else 0, (W,)."""
    n, end = border, border + out.shape[0]
    row, z = depth[k], depth[k, n:end]
    out[:] = 0
    sides = row[n - 3 : end - 3], row[n - 4 : end - 4], row[n + 3 : end + 3], row[n + 4 : end + 4]
    _along(z, row[n - 1 : end - 1], row[n + 1 : end + 1], sides, least_x, half_order, out)
    sides = depth[k - 3, n:end], depth[k - 4, n:end], depth[k + 3, n:end], depth[k + 4, n:end]
    _along(z, depth[k - 1, n:end], depth[k + 1, n:end], sides, least_y, half_order, out)
