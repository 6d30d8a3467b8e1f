"""A contest between surfaces that pictures of noise never have: it compiles what only real scenes would."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline import rivals
from pipeline.uniqueness import Uniqueness

_SIDE = 16


def rehearse_contest() -> None:
    """Let two small surfaces claim the same pixels of another device, in arrays of the kinds that the gates use."""
    shape = (_SIDE, _SIDE)
    v, u = np.indices(shape).astype(np.float32)
    known, phase = np.ones(shape, np.uint8), np.zeros(shape, np.float32)
    order = np.zeros(shape, np.int16)
    label = (np.arange(_SIDE * _SIDE, dtype=np.int32) % 2).reshape(shape)
    size = np.full(2, label.size // 2, np.int32)
    depth = np.where(label == 0, np.float32(1000), np.float32(1100)).astype(np.float32)

    def absolute(entries: Any, pixel: Any, _: Any, out: Any) -> None:
        rivals.absolute_phases(entries, pixel, phase.reshape(-1), order.reshape(-1), out)

    def parameter(entries: Any, _: Any, depth: Any, out: Any) -> None:
        rivals.parameters(entries, depth, np.float32(0), np.float32(1), out)

    contest = Uniqueness(shape, (shape,))
    for value_of in (absolute, parameter):
        contest.apply(known, label, size, u // 2, v, depth, shape, value_of, 1.5, label.size)
