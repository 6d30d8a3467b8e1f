"""Median of some thousand numbers."""

from __future__ import annotations

from typing import Any

import numpy as np


def median(values: Any) -> float:
    """Median of numbers (n,) without NaN, n > 0.

    The same as ``np.median``, at a fraction of its time, which goes into tests for NaN.
    """
    low, high = (len(values) - 1) // 2, len(values) // 2
    return float(np.partition(values, (low, high))[low : high + 1].mean())
