"""Arithmetic of kernels that work on tiles: short rows of pixels, one slot of a small scratch array for each quantity.

A tile's loops run over a constant number of elements of one array at constant offsets. The compiler then proves that
slots do not overlap and uses the widest vector instructions; look-ups, which do not vectorise, have scalar loops of
their own between the arithmetic ones. The scratch array stays in the first-level cache.
"""

from __future__ import annotations

from math import sqrt
from typing import Any

import numpy as np

from pipeline.common.jit import inline

TILE = 128

_HALF_PI, _PI = np.float32(np.pi / 2), np.float32(np.pi)
_TINY, _ZERO = np.float32(1e-20), np.float32(0)
_A1, _A2, _A3 = np.float32(0.999999336), np.float32(-0.333298614), np.float32(0.199465738)
_A4, _A5, _A6 = np.float32(-0.139086730), np.float32(0.096423145), np.float32(-0.055914005)
_A7, _A8 = np.float32(0.021864171), np.float32(-0.004054916)
_UNIT, _EIGHTH = np.float32(1), np.float32(0.125)
_C2, _C3, _C4 = np.float32(1 / 2), np.float32(1 / 6), np.float32(1 / 24)
_INV_TURN = np.float32(1 / (2 * np.pi))


@inline
def whole_turns(a: Any) -> Any:
    """Nearest whole number of turns, as float32."""
    return np.float32(np.rint(a * _INV_TURN))


@inline
def clamped(x: Any, low: Any, high: Any) -> Any:
    """Clamp x to two limits; NaN gives the low one, so that the result is safe as an index."""
    x = x if x > low else low
    return x if x < high else high


@inline
def angle(c: Any, s: Any) -> Any:
    """Angle of (c, s), float32, error below 2e-7 rad; an odd polynomial fitted to the arctangent."""
    x, y = abs(c), abs(s)
    swap = y > x
    high = y if swap else x
    low = x if swap else y
    q = low / (high + _TINY)
    z = q * q
    p = _A5 + z * (_A6 + z * (_A7 + z * _A8))
    p = q * (_A1 + z * (_A2 + z * (_A3 + z * (_A4 + z * p))))
    p = _HALF_PI - p if swap else p
    p = _PI - p if c < _ZERO else p
    return -p if s < _ZERO else p


@inline
def root(x: Any) -> Any:
    """Square root in single precision."""
    return np.float32(sqrt(x))


@inline
def decay(x: Any) -> Any:
    """Approximate exp(-x) for 0 <= x <= 8 within 1e-4: the eighth power of a short series needs no call in a loop."""
    y = x * _EIGHTH
    e = _UNIT - y + y * y * (_C2 - y * (_C3 - y * _C4))
    e = e * e
    e = e * e
    return e * e
