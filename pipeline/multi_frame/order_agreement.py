"""Orders of one fringe that a second fringe agrees with."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline, parallel, prange
from pipeline.common.tile_math import whole_turns
from pipeline.decode.pixel_descriptor import bias_of
from pipeline.multi_frame.temporal_unwrapping import NONE

_TURN, _ZERO, _ONE = np.float32(2 * np.pi), np.float32(0), np.float32(1)


@inline
def _wrapped(a: Any) -> Any:
    return a - _TURN * whole_turns(a)


@inline
def _lesser(a: Any, b: Any) -> Any:
    a, b = abs(a), abs(b)
    return a if a < b else b


@parallel
def agreed(
    order: Any, phase: Any, descriptors: Any, valid: Any, other_order: Any, other: Any, other_descriptors: Any,
    other_valid: Any,
    ratio: Any, limit: Any, out: Any, away: Any, lit: Any,
) -> None:  # fmt: skip
    """The first fringe's order, or what the second's makes it, where the other phase fits and the two agree.

    Args:
        order, phase, descriptors, valid: (H, W) of the first fringe; other ...: of the second.
        ratio: periods of the second per period of the first; limit: largest deviation of the second phase, radians.
        out: (H, W) int16, written, NONE where unknown.
        away: (H, W) float32, written: deviation of the phases squared, radians^2; lit: 1 where both are valid, else 0.
    """
    for i in prange(order.shape[0]):
        for j in range(order.shape[1]):
            out[i, j], away[i, j], lit[i, j] = NONE, _ZERO, _ZERO
            if not valid[i, j] or not other_valid[i, j]:
                continue
            lit[i, j] = _ONE
            here, there = phase[i, j], other[i, j]
            bias, bias_there = bias_of(descriptors[i, j], here), bias_of(other_descriptors[i, j], there)
            first, second = order[i, j], NONE
            least, least_second = np.float32(np.pi), np.float32(np.pi)
            if first != NONE:
                plain = here + _TURN * np.float32(first)
                even = _wrapped(there + bias_there - ratio * (plain + bias))
                least = _lesser(_wrapped(there - ratio * plain), even)
            if other_order[i, j] != NONE:
                plain = there + bias_there + _TURN * np.float32(other_order[i, j])
                second = np.int16(whole_turns(plain / ratio - here - bias))
                expected = here + _TURN * np.float32(second)
                even = plain - ratio * (expected + bias)
                least_second = _lesser(plain - bias_there - ratio * expected, even)
            good, good_second = least < limit, least_second < limit
            if good and good_second and first != second:
                continue
            if good or good_second:
                out[i, j] = first if good else second
            elif first != NONE or second != NONE:
                least = least if least < least_second else least_second
                away[i, j] = least * least
