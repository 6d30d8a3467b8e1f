"""Orders proposed by neighbouring surfaces."""

from __future__ import annotations

from typing import Any

import numpy as np

from pipeline.match.neighbour_orders import NONE, classify_row, propose_row

SLOPE = 0.5


def _scene() -> tuple[Any, Any, Any]:
    """Order, wrapped phase and deviation of two surfaces, about 3 periods apart, that meet at column 40."""
    height, width = 12, 90
    absolute = np.tile(SLOPE * np.arange(width), (height, 1)) + 0.3
    absolute[:, 40:] += 3 * 2 * np.pi + 1.0
    order = np.rint(absolute / (2 * np.pi)).astype(np.int16)
    phase = (absolute - 2 * np.pi * order).astype(np.float32)
    return order, phase, np.full((height, width), 8, np.uint8)


def _found(order: Any, phase: Any, deviation: Any, usable: Any | None = None) -> dict[int, set[int]]:
    usable = np.ones(order.shape, bool) if usable is None else usable
    by_pixel: dict[int, set[int]] = {}
    width = order.shape[1]
    state, ahead = np.zeros(-(-width // 8) * 8, np.uint8), np.empty(width, np.int16)
    columns, orders = np.empty(width, np.int32), np.empty(width, np.int16)
    for i in range(len(order)):
        classify_row(deviation[i], usable[i], 24, 48, state)
        ahead[:] = NONE
        for side in range(2):
            n = propose_row(
                side, state, order[i], phase[i], np.float32(SLOPE), 8, np.float32(1.5), ahead, columns, orders
            )
            for j, m in zip(columns[:n], orders[:n], strict=True):
                proposals = by_pixel.setdefault(i * width + int(j), set())
                assert int(m) not in proposals
                proposals.add(int(m))
    return by_pixel


def test_pixels_that_agree_get_no_other_order() -> None:
    assert not _found(*_scene())


def test_a_strip_with_the_order_of_the_wrong_side_gets_that_of_its_own() -> None:
    order, phase, deviation = _scene()
    true = order.copy()
    order[:, 40:44] -= 3
    deviation[:, 40:44] = 200
    found = _found(order, phase, deviation)
    for i in range(order.shape[0]):
        for j in range(40, 44):
            assert int(true[i, j]) in found[i * order.shape[1] + j]


def test_far_pixels_and_those_without_a_phase_get_nothing() -> None:
    order, phase, deviation = _scene()
    order[:, 20:70] -= 2
    deviation[:, 20:70] = 255
    usable = np.ones(order.shape, bool)
    usable[:, 62:] = False
    found = _found(order, phase, deviation, usable)
    columns = {pixel % order.shape[1] for pixel in found}
    assert columns and columns <= {*range(20, 28)}
