"""Readings of pairs of a rendered rig: zero without a disturbance, else as the formulas predict."""

from __future__ import annotations

from functools import cache
from itertools import islice

import numpy as np
import pytest

from benchmarks.calibration.selfcheck import Rig
from drivers.protocols import Side
from pipeline.common.errors import ImageError
from pipeline.monitor.observe import Observation, Observer, Reading, warm_up
from pipeline.reconstruct.cloud import Cloud
from sim.rig.disturbance import Disturbance

pytestmark = pytest.mark.timeout(400)
SCALE = 0.375


@cache
def rig(scene: str = "moving", encoding: str = "rgb8") -> Rig:
    return Rig(SCALE, scene=scene, encoding=encoding, patches=400, instants=2)


def read(made: Rig, *disturbances: Disturbance) -> dict[str, Reading]:
    """Mean of two pairs."""
    seen: list[Observation] = list(islice(made.observations(made.scene(*disturbances)), 2))
    names = set.intersection(*(set(one.readings) for one in seen))
    return {
        name: Reading(
            float(np.mean([one.readings[name].value for one in seen])),
            float(np.mean([one.readings[name].sigma for one in seen]) / np.sqrt(2)),
        )
        for name in names
    }


@cache
def still() -> dict[str, Reading]:
    return read(rig())


def changes(*disturbances: Disturbance) -> dict[str, float]:
    after = read(rig(), *disturbances)
    return {name: after[name].value - still()[name].value for name in after}


@pytest.mark.parametrize("encoding", ["rgb8", pytest.param("bayer_rggb8", marks=pytest.mark.long)])
def test_an_undisturbed_rig_reads_nothing(encoding: str) -> None:
    readings = still() if encoding == "rgb8" else read(rig(encoding=encoding))
    for name, reading in readings.items():
        if not name.endswith("modulation"):
            assert abs(reading.value) < 5 * reading.sigma + 0.0015, (name, reading)
    assert readings["column_px"].sigma < 0.001 and readings["epipolar_px"].sigma < 0.03


@pytest.mark.slow
@pytest.mark.parametrize(("side", "share"), [("right", 0.382), pytest.param("left", 0.618, marks=pytest.mark.long)])
def test_a_shifted_lens_moves_the_trinocular_residual_by_its_share(side: Side, share: float) -> None:
    """0.382 of a shift of the right image, the rest of one of the left, times the ratio of the focal lengths."""
    shifted = changes(Disturbance(side, shift_px=(0.2, 0)))
    assert shifted["column_px"] == pytest.approx(-0.2 * share * 4267 / 3413, rel=0.1)


@pytest.mark.slow
@pytest.mark.parametrize(("side", "sign"), [("left", -1), pytest.param("right", 1, marks=pytest.mark.long)])
def test_a_rotation_of_a_hundredth_of_a_degree_is_observed_about_each_axis(side: Side, sign: int) -> None:
    pitch = changes(Disturbance(side, turn_deg=(0.01, 0, 0)))
    shift = 3413 * SCALE * np.deg2rad(0.01)
    assert pitch["epipolar_px"] == pytest.approx(-sign * shift, abs=0.1) and abs(pitch["column_px"]) < 0.01
    roll = changes(Disturbance(side, turn_deg=(0, 0, 0.01)))
    assert abs(roll["column_y_px"]) > 0.01 and abs(roll["column_px"]) < 0.01


@pytest.mark.slow
def test_crosstalk_shifts_the_channels_of_its_own_camera_only() -> None:
    found = changes(Disturbance("right", crosstalk=0.03))
    right = [abs(found[f"right_{color}_rad"]) for color in ("red", "green", "blue")]
    left = [abs(found[f"left_{color}_rad"]) for color in ("red", "green", "blue")]
    assert max(right) > 0.012 and max(left) < 0.002 and abs(found["column_px"]) < 0.02


@pytest.mark.slow
def test_a_frontal_wall_hardly_determines_the_epipolar_residual() -> None:
    wall = read(rig("plane"))
    assert wall["column_px"].sigma < 0.001
    assert "epipolar_px" not in wall or wall["epipolar_px"].sigma > 0.04


def test_every_second_pixel_of_the_cloud_is_enough() -> None:
    made = rig()
    left, right = made.scene().pair(0)
    full, half = (
        Observer(made.calibration, made.pattern, made.volume, patches=400).observe(
            left, right, made.reconstructor.reconstruct(left, right, stride=stride)
        )
        for stride in (1, 2)
    )
    assert half.patches > 0.8 * full.patches
    assert half.readings["column_px"].value == pytest.approx(full.readings["column_px"].value, abs=0.005)


def test_no_surface_gives_no_reading() -> None:
    made = rig()
    left, right = made.scene().pair(0)
    height, width = left.shape[:2]
    nothing = np.full((height, width, 3), np.nan, np.float32)
    plane = np.full((height, width), 50, np.uint8)
    cloud = Cloud(nothing, nothing[..., 0], plane, (plane, plane), np.zeros((height, width), np.int16))
    seen = made.observer.observe(left, right, cloud)
    assert not seen.readings and seen.patches == 0 and seen.lit == 1.0 and seen.valid == 0.0
    with pytest.raises(ImageError):
        made.observer.observe(left[:-1], right, cloud)


def test_the_kernel_can_be_compiled_beforehand() -> None:
    warm_up()
