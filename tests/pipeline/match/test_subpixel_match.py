"""The match between two pixels of the other image counts only where those agree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from pipeline.common.settings import Settings
from pipeline.common.stopwatch import Stopwatch
from pipeline.match.match_result import PIXEL_STEPS
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics
from sim.scene.named_scenes import build
from tests.renders import render_pair

LAYOUT = RigLayout().scaled(0.25)


@pytest.fixture(scope="module")
def decoded() -> Any:
    """A reconstructor, phases of both images of a plane, and orders."""
    pair = render_pair(LAYOUT, build("plane"), LAYOUT.pattern(), Optics(), seed=1)
    settings = Settings(cluster_min_area=20, self_calibrate=False)
    made = Reconstructor(LAYOUT.calibration_for(Optics()), LAYOUT.pattern(), LAYOUT.volume(), settings=settings)
    return made, *made.orders(pair.left, pair.right, Stopwatch(None))


def _from_row(decoded: Any, *, opposed: bool) -> Any:
    """Distances of all matches from the nearest row of the right image, whose odd rows may have opposed phasors."""
    made, left, right, order = decoded
    if opposed:
        phasor = right.phasor.copy()
        phasor[1::2] = (-phasor[1::2].view(np.int16)).view(np.int32)
        right = replace(right, phasor=phasor)
    match = made.stage(1).match(left, right, order, made.correction)
    row = (match.right_v[match.valid != 0].astype(float) + 0.5) / PIXEL_STEPS - 0.5
    return np.abs(row - np.rint(row))


def test_no_point_lies_between_rows_that_contradict_each_other(decoded: Any) -> None:
    usual, opposed = (_from_row(decoded, opposed=opposed) for opposed in (False, True))
    # Between rows of opposite phase, x from one of them, the phasor has 1 - 2 x of its length; less than 0.4 is too
    # little. At the rim of the lit surface the other row is dark.
    between = 0.3 + 0.5 / PIXEL_STEPS
    assert np.mean(usual > between) > 0.2
    assert opposed.size > 0.2 * usual.size and np.mean(opposed > between) < 0.01
