"""Compilation of the occlusion kernels by a conflict between surfaces, which images of noise never have."""

from __future__ import annotations

import numpy as np

from pipeline.filter.occlusion.occlusion_conflicts import PARAMETER_STEPS, Values
from pipeline.filter.occlusion.uniqueness import Uniqueness
from pipeline.match.match_result import PIXEL_STEPS, Points

_SIDE = 16


def warm_up_conflicts() -> None:
    """Let two small surfaces claim the same pixels of another device, in arrays of the types that the filters use."""
    shape = (_SIDE, _SIDE)
    v, u = (PIXEL_STEPS * np.indices(shape)).astype(np.uint16)
    label = (1 + np.arange(_SIDE * _SIDE) % 2).astype(np.uint16).reshape(shape)
    size = np.full(2, label.size // 2, np.int32)
    points = Points.empty(shape)
    points.xyz[..., 2] = np.where(label == 1, 1000, 1100)
    uniqueness = Uniqueness(shape, (shape,))
    for by_depth in (False, True):
        values = Values((1000 * label).astype(np.int16), by_depth, np.float32(0), np.float32(1e-3))
        valid = np.ones(shape, np.uint8)
        uniqueness.apply(valid, label, size, u, v, points.depth_mm(1), shape, values, PARAMETER_STEPS // 4, label.size)
