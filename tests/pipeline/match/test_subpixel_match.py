"""The match between two pixels of the other image counts only where those agree."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import cv2
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


@pytest.mark.parametrize("periods", [12.0, 24.0, 32.0])
def test_every_match_lies_in_the_right_image(periods: float) -> None:
    """Also where the phase hardly changes, so that the last step of the search is many pixels long."""
    layout = RigLayout().scaled(0.25)
    width, height = layout.camera_size
    made = Reconstructor(
        layout.calibration_for(Optics()), layout.pattern(periods), layout.volume(),
        settings=Settings(self_calibrate=False),
    )  # fmt: skip
    matched = 0
    for seed in range(4):
        rng = np.random.default_rng(seed)
        images = [200 * (1 + seed) * rng.standard_normal((height, width, 3), np.float32) for _ in range(2)]
        left, right = (
            decoder.decode(np.clip(cv2.GaussianBlur(noise, (0, 0), 1 + seed) + 120, 0, 255).astype(np.uint8))
            for decoder, noise in zip(made.decoders, images, strict=True)
        )
        match = made.match(left, right)
        valid = match.valid != 0
        assert (match.right_u[valid] < width * PIXEL_STEPS).all()
        assert (match.right_v[valid] < height * PIXEL_STEPS).all()
        matched += int(valid.sum())
    assert matched > 10_000
