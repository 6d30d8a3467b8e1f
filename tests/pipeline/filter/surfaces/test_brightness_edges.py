"""Surfaces are divided where the brightness changes, and nowhere else."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP
from pipeline.common.parallel_for import blocks
from pipeline.filter.surfaces import brightness_edges
from pipeline.filter.surfaces.brightness_edges import CONTRAST_PERCENT, DARK, REACH, DividedSurfaces, cut_links

SHAPE = (37, 60)
ALL = LEFT | UP


def edges(brightness: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """By the definition, with OpenCV's filters."""
    window = np.ones((2 * REACH + 1, 2 * REACH + 1), np.uint8)
    most, least = (f(brightness, window).astype(int) for f in (cv2.dilate, cv2.erode))
    return np.asarray(100 * (most - least) > CONTRAST_PERCENT * (most + least + DARK))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 70), st.sampled_from([1.0, 3.0, 6.0]))
def test_links_between_edges_and_other_pixels_are_cut(seed: int, height: int, width: int, blur: float) -> None:
    rng = np.random.default_rng(seed)
    counts = cv2.GaussianBlur(rng.normal(0, 100, (height, width)), (0, 0), blur) * blur + 100
    brightness = np.clip(counts, 0, 255).astype(np.uint8)
    link, out = rng.integers(0, 4, brightness.shape).astype(np.uint8), np.full(brightness.shape, 9, np.uint8)
    cut_links(blocks(height, brightness_edges._ROWS), brightness, link, out)
    at = edges(brightness)
    expected = link.copy()
    expected[:, 1:][at[:, 1:] != at[:, :-1]] &= ~LEFT
    expected[1:][at[1:] != at[:-1]] &= ~UP
    # Nothing lies to the left of the first column or above the first row.
    expected[:, 0] &= ~LEFT
    expected[0] &= ~UP
    assert (out == expected).all()


def found(brightness: NDArray[np.uint8], smallest: int = 20) -> DividedSurfaces:
    made = DividedSurfaces(brightness.shape)
    made.find(np.ones(brightness.shape, np.uint8), brightness, np.full(brightness.shape, ALL, np.uint8), smallest)
    return made


@pytest.mark.parametrize(("wall", "object_", "divided"), [(100, 140, True), (100, 128, False), (4, 8, False)])
def test_an_object_the_wall_and_the_edge_between_them_are_three_surfaces(
    wall: int, object_: int, divided: bool
) -> None:
    """Of counts that differ by 16 %, by 11 %, and by no more than the noise."""
    brightness = np.full(SHAPE, wall, np.uint8)
    brightness[:, 30:] = object_
    made = found(brightness)
    if not divided:
        assert made.surfaces.sizes.tolist() == [brightness.size]
        return
    assert made.surfaces.sizes.tolist() == [37 * (30 - REACH), 37 * 2 * REACH, 37 * (30 - REACH)]
    assert (made.label == np.repeat([1, 2, 3], [30 - REACH, 2 * REACH, 30 - REACH])).all()


def test_gradual_changes_divide_nothing() -> None:
    ramp = np.tile(np.linspace(40, 200, SHAPE[1]).astype(np.uint8), (SHAPE[0], 1))
    assert found(ramp).surfaces.sizes.tolist() == [ramp.size]


def test_small_parts_are_none() -> None:
    brightness = np.full(SHAPE, 100, np.uint8)
    brightness[10:20, 10:20] = 200
    sizes = [int(n) for n in found(brightness, 5).surfaces.sizes]
    inside = (10 - 2 * REACH) ** 2
    assert inside in sizes
    assert inside not in found(brightness, inside + 1).surfaces.sizes
