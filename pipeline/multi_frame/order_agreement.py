"""Orders of one fringe that a second fringe confirms."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.common.jit import inline
from pipeline.common.parallel_for import parallel
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
def agreed_orders(
    i: int, order: Any, phase: Any, descriptors: Any, valid: Any, other_order: Any, other: Any, other_descriptors: Any,
    other_valid: Any,
    ratio: Any, limit: Any, out: Any, deviation: Any, lit: Any,
) -> None:  # fmt: skip
    """The order of the first fringe, or the one that the second implies, where phases fit and orders agree.

    Args:
        order, phase, descriptors, valid: (H, W) of the first fringe; other ...: of the second.
        ratio: periods of the second per period of the first; limit: largest deviation of the second phase, radians.
        out: (H, W) int16, written, NONE where unknown.
        deviation: (H, W) float32, written: squared deviation of the phases, radians^2; lit: 1 where both are
            valid, else 0.
    """
    for j in range(order.shape[1]):
        out[i, j], deviation[i, j], lit[i, j] = NONE, _ZERO, _ZERO
        if not valid[i, j] or not other_valid[i, j]:
            continue
        lit[i, j] = _ONE
        reference, other_phase = phase[i, j], other[i, j]
        bias, other_bias = bias_of(descriptors[i, j], reference), bias_of(other_descriptors[i, j], other_phase)
        first, second = order[i, j], NONE
        least, least_second = np.float32(np.pi), np.float32(np.pi)
        if first != NONE:
            plain = reference + _TURN * np.float32(first)
            even = _wrapped(other_phase + other_bias - ratio * (plain + bias))
            least = _lesser(_wrapped(other_phase - ratio * plain), even)
        if other_order[i, j] != NONE:
            plain = other_phase + other_bias + _TURN * np.float32(other_order[i, j])
            second = np.int16(whole_turns(plain / ratio - reference - bias))
            expected = reference + _TURN * np.float32(second)
            even = plain - ratio * (expected + bias)
            least_second = _lesser(plain - other_bias - ratio * expected, even)
        good, good_second = least < limit, least_second < limit
        if good and good_second and first != second:
            continue
        if good or good_second:
            out[i, j] = first if good else second
        elif first != NONE or second != NONE:
            least = least if least < least_second else least_second
            deviation[i, j] = least * least
