"""Small surfaces that are left in a large region with fringes and without points are rejected as parts of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pipeline.common.connected_components import LEFT, UP, Surfaces
from pipeline.filter.surfaces.surface_evidence import Figures
from pipeline.filter.surfaces.unconfirmed_surfaces import LEAST_LOSS
from pipeline.filter.surfaces.unexplained_regions import (
    LEAST_OPEN,
    REGION_SHARE,
    TIMES_SURFACE,
    UnexplainedRegions,
)
from pipeline.fringe_order.margins.order_margins import Continued

SHAPE, LARGE, LOSS = (80, 100), 1000, 0.3
PLATE, REMAINS, BESIDE_PLATE = np.s_[:, :40], np.s_[30:36, 70:76], np.s_[10:16, 60:66]
OUTSIDE = [PLATE, REMAINS, BESIDE_PLATE]


def remaining(
    usable: NDArray[np.bool_], *, unknown: float = 1.0, loss: float = LOSS, large: int = LARGE
) -> dict[str, bool]:
    """Which of three surfaces, a plate and two small ones with these figures, still have points: all or none."""
    valid = np.zeros(SHAPE, np.uint8)
    for part in OUTSIDE:
        valid[part] = 1
    surfaces, label = Surfaces(SHAPE), np.empty(SHAPE, np.uint16)
    surfaces.find(valid, np.full(SHAPE, LEFT | UP), 30)
    surfaces.paint(label)
    assert surfaces.sizes.tolist() == [3200, 36, 36]
    n = 3
    one, share = np.ones(n), np.full(n, unknown / 2, np.float32)
    figures = Figures(surfaces.sizes, np.full(n, loss), one, one, one, one, one, np.zeros(n, bool))
    continued = Continued(np.zeros(n, np.int32), np.zeros(n, np.float32), share, share)
    UnexplainedRegions(SHAPE).reject_remains(usable, valid, label, surfaces, figures, continued, LOSS, large)
    assert all(valid[part].all() == valid[part].any() for part in OUTSIDE)
    return {name: bool(valid[part].all()) for name, part in zip(("plate", "one", "other"), OUTSIDE, strict=True)}


def region(rows: Any = slice(None), columns: Any = slice(45, None)) -> NDArray[np.bool_]:
    """Fringes on the plate, and on a wall in these rows and columns."""
    usable = np.zeros(SHAPE, bool)
    usable[PLATE], usable[rows, columns] = True, True
    return usable


def test_what_is_left_in_the_region_has_no_points_and_the_large_surface_stays() -> None:
    assert remaining(region()) == {"plate": True, "one": False, "other": False}


def test_a_seam_of_pixels_without_fringes_around_a_surface_does_not_hide_the_region() -> None:
    usable = region()
    usable[29:37, 69:77] = False
    usable[REMAINS] = True
    assert not remaining(usable)["one"]


def test_surfaces_outside_of_the_region_stay() -> None:
    assert remaining(region(rows=slice(25, None))) == {"plate": True, "one": False, "other": True}


@pytest.mark.parametrize("factor", [0.98, 1.02])
@pytest.mark.parametrize("which", ["open", "loss"])
def test_each_figure_is_necessary(which: str, factor: float) -> None:
    k = {"open": 1.02, "loss": 1.02} | {which: factor}
    kept = remaining(region(), unknown=k["open"] * LEAST_OPEN, loss=k["loss"] * LEAST_LOSS * LOSS)
    assert kept["one"] == kept["other"] == (factor < 1)


@pytest.mark.parametrize("columns", [23, 24])
def test_the_region_is_many_times_as_large_as_the_surface(columns: int) -> None:
    """Of 80 rows without the surfaces' 72 pixels; a tenth of the image is less."""
    usable = region(columns=slice(60, 60 + columns))
    size = np.count_nonzero(usable[:, 60:]) - 72
    assert size > REGION_SHARE * usable.size
    assert remaining(usable)["one"] == (size < TIMES_SURFACE * 36)


def test_a_region_of_less_than_a_tenth_of_the_image_does_not_count() -> None:
    usable = region(rows=slice(25, 41), columns=slice(50, 98))
    assert 0 < np.count_nonzero(usable[:, 50:]) - 36 < REGION_SHARE * usable.size
    assert remaining(usable)["one"]


def test_large_surfaces_are_not_tested() -> None:
    assert remaining(region(), large=36) == {"plate": True, "one": True, "other": True}


def test_without_surfaces_nothing_happens() -> None:
    valid, surfaces, none = np.zeros(SHAPE, np.uint8), Surfaces(SHAPE), np.empty(0)
    surfaces.find(valid, np.full(SHAPE, LEFT | UP), 30)
    figures = Figures(none, none, none, none, none, none, none, none)
    label = np.zeros(SHAPE, np.uint16)
    UnexplainedRegions(SHAPE).reject_remains(region(), valid, label, surfaces, figures, Continued.none(0), LOSS, LARGE)
    assert not valid.any()
