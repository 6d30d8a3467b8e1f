"""Orders between confident decisions that agree along continuous phase need no search; no others are filled in."""

from __future__ import annotations

import numpy as np
import pytest

from pipeline.fringe_order.coarse_to_fine import interpolate_orders
from pipeline.fringe_order.semi_global_aggregation import NONE

TOP, DOWN, LEFT, STEP = 3, 2, 3, 3
SLOPE = 0.6


def lattice(shape: tuple[int, int]) -> tuple[slice, slice]:
    h, w = shape
    return slice(TOP, TOP + DOWN * h, DOWN), slice(LEFT, LEFT + STEP * w, STEP)


def certain(absolute: np.ndarray, valid: np.ndarray, confident: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Certain orders of an image of absolute phases whose every second lattice pixel is decided correctly."""
    order = np.round(absolute / (2 * np.pi)).astype(np.int16)
    phase = (absolute - 2 * np.pi * order).astype(np.float32)
    coarse = np.ascontiguousarray(order[lattice(shape)][::2, ::2])
    out = np.full(shape, 99, np.int16)
    interpolate_orders(coarse, confident, phase, valid, TOP, DOWN, LEFT, STEP, np.float32(SLOPE), np.float32(0), out)
    return out


def case(shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    v, u = np.mgrid[0 : TOP + DOWN * shape[0] + 3, 0 : LEFT + STEP * shape[1] + 4].astype(float)
    absolute = 40 + SLOPE * u + 0.9 * np.sin(u / 15) + 0.35 * v
    confident = np.ones((-(-shape[0] // 2), -(-shape[1] // 2)), np.uint8)
    return absolute, np.ones(absolute.shape, bool), confident


@pytest.mark.parametrize("shape", [(1, 1), (2, 2), (9, 7), (30, 44), (31, 45)])
def test_a_smooth_surface_is_filled_up_to_the_last_confident_pixel(shape: tuple[int, int]) -> None:
    absolute, valid, confident = case(shape)
    out = certain(absolute, valid, confident, shape)
    inside = np.s_[: 2 * ((shape[0] - 1) // 2) + 1, : 2 * ((shape[1] - 1) // 2) + 1]
    expected = np.full(shape, NONE)
    expected[inside] = np.round(absolute / (2 * np.pi))[lattice(shape)][inside]
    np.testing.assert_array_equal(out, expected)


def test_certain_orders_are_correct_on_any_surface() -> None:
    shape = (60, 80)
    rng = np.random.default_rng(5)
    absolute, valid, confident = case(shape)
    i, j = np.indices(absolute.shape)
    absolute += 2 * np.pi * 1.3 * ((i > 50) & (j > 70)) + 9.1 * (j > 160) + rng.normal(0, 0.08, absolute.shape)
    valid &= rng.random(valid.shape) > 0.005
    valid[20:30, 40:90] = False
    confident &= (rng.random(confident.shape) > 0.05).astype(np.uint8)
    out = certain(absolute, valid, confident, shape)
    truth = np.round(absolute / (2 * np.pi))[lattice(shape)]
    known = out != NONE
    assert 0.5 < known.mean() < 0.95
    assert (out == truth)[known].all()


@pytest.mark.parametrize(("what", "b"), [("row", 4), ("row", 5), ("column", 4), ("column", 5)])
def test_no_order_is_filled_across_an_edge_or_an_invalid_pixel(what: str, b: int) -> None:
    shape = (12, 12)
    for spoil in ("edge", "invalid"):
        absolute, valid, confident = case(shape)
        at = np.s_[TOP + DOWN * b + 1 :] if what == "row" else np.s_[:, LEFT + STEP * b + 1 :]
        line = np.s_[TOP + DOWN * b + 1] if what == "row" else np.s_[:, LEFT + STEP * b + 1]
        if spoil == "edge":
            absolute[at] += 2.6
        else:
            valid[line] = False
        out = certain(absolute, valid, confident, shape)
        odd = 2 * (b // 2) + 1
        crossing = out[odd, ::2] if what == "row" else out[::2, odd]
        assert (crossing[:-1] == NONE).all()


def test_an_unconfident_pixel_and_the_ones_it_would_decide_stay_open() -> None:
    shape = (9, 9)
    absolute, valid, confident = case(shape)
    confident[2, 2] = 0
    out = certain(absolute, valid, confident, shape)
    assert (out[3:6, 3:6] == NONE).all()
    assert (out == NONE).sum() == 9
