"""The texture in the cost of fringe orders: limited, and weighted by whether the pair is calibrated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.fringe_order.order_candidates import COST_UNOBSERVED
from pipeline.fringe_order.order_search import UNCALIBRATED
from pipeline.reconstruct.reconstructor import Reconstructor
from tests.pipeline.small import images, pair, reconstructor


@pytest.mark.parametrize("mean", [0, 255])
def test_a_texture_of_another_place_costs_less_than_a_place_without_fringes(mean: int) -> None:
    """A right order keeps winning against one that leads into the dark, whatever stands beside it in the image."""
    made = reconstructor()
    left, right, _ = made.orders(*images(pair("mixed")), Stopwatch(None))
    changed = replace(right, descriptors=(right.descriptors & ~255) | mean)
    alike, different = (
        made.searches[0].least_costs(left, each, made.correction, stride=8).astype(float) for each in (right, changed)
    )
    assert np.abs(different - alike).max() < COST_UNOBSERVED
    assert np.median(different - alike) > 0.1


def test_until_a_pair_is_calibrated_the_texture_counts_less() -> None:
    """The search of an uncalibrated pair is that of a smaller weight; that of a calibrated one finds other orders."""
    default = Settings().texture_weight
    full, less = (reconstructor(settings=Settings(texture_weight=w)) for w in (default, UNCALIBRATED * default))
    left, right, _ = full.orders(*images(pair("slots")), Stopwatch(None))

    def orders(made: Reconstructor, **options: float) -> NDArray[np.int16]:
        return made.searches[0].search(left, right, full.correction, use_prior=False, **options).copy()

    uncalibrated = orders(full, texture=UNCALIBRATED)
    np.testing.assert_array_equal(uncalibrated, orders(less))
    assert (uncalibrated != orders(full)).any()
