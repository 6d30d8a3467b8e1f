"""Calibrations that no rig can have are refused, each with key, value and limit; every simulated rig passes."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from pipeline.common.errors import CalibrationError
from pipeline.rig.calibration import from_mapping, to_mapping
from pipeline.rig.plausibility import check_volume
from pipeline.rig.volume import Volume
from sim.rig.layout import RigLayout

LAYOUT = RigLayout()
Mapping = dict[str, Any]


def mapping() -> Mapping:
    return copy.deepcopy(to_mapping(LAYOUT.calibration()))


@pytest.mark.parametrize("scale", [0.1, 0.25, 1.0, 2.0])
@pytest.mark.parametrize("fraction", [0.1, 0.382, 0.5, 0.9])
def test_every_simulated_rig_is_plausible_with_its_volume(scale: float, fraction: float):
    layout = RigLayout(projector_fraction=fraction).scaled(scale)
    calibration = from_mapping(to_mapping(layout.calibration()))
    check_volume(calibration.left, calibration.right, layout.volume())


def _matrix(side: str, row: int, column: int, value: float) -> Callable[[Mapping], None]:
    def change(data: Mapping) -> None:
        device = data["projector"] if side == "projector" else data["cameras"][side]
        device["matrix"][row][column] = value

    return change


def _set(path: str, value: object) -> Callable[[Mapping], None]:
    def change(data: Mapping) -> None:
        *way, last = path.split(".")
        for key in way:
            data = data[key]
        data[last] = value

    return change


def _metres(data: Mapping) -> None:
    for device in (data["cameras"]["right"], data["projector"]):
        device["translation"] = (np.array(device["translation"]) / 1000).tolist()


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (_metres, r"cameras\.right\.translation: 0\.5 mm .*limits 5 and 20000 mm.*projector\.translation"),
        (_set("cameras.left.distortion", [50.0, 0, 0, 0, 0]), r"cameras\.left\.distortion: .* limit 0\.5"),
        (_set("cameras.right.distortion", [-12.0, 0, 0, 0, 0]), r"cameras\.right\.distortion: .* by inf"),
        (_matrix("left", 0, 2, 5000.0), r"cameras\.left\.matrix: cx is 5000 px, limits 153\.6 and 870\.4"),
        (_matrix("projector", 1, 2, -4000.0), r"projector\.matrix: cy is -4000 px"),
        (_matrix("right", 0, 0, 34.13), r"cameras\.right\.matrix: focal length 34\.13 px .*limits 204\.8"),
        (_matrix("right", 1, 1, 1000.0), r"cameras\.right\.matrix: fx / fy is 3\.41, limits 0\.7 and 1\.43"),
        (
            _set("cameras.right.rotation", [[-1, 0, 0], [0, 1, 0], [0, 0, -1]]),
            r"cameras\.right\.rotation: .* 180\.0 degrees .* limit 100",
        ),
    ],
)
def test_what_no_rig_can_be_is_refused(change: Callable[[Mapping], None], sentence: str):
    data = mapping()
    change(data)
    with pytest.raises(CalibrationError, match=sentence):
        from_mapping(data)


@pytest.mark.parametrize(
    ("path", "key", "meant"),
    [
        ("cameras.left", "colour", "color"),
        ("cameras.right", "Distortion", "distortion"),
        ("cameras.left.color", "cross_talk", "crosstalk"),
        ("projector", "responce", "response"),
        ("", "projektor", "projector"),
    ],
)
def test_a_misspelt_key_is_refused_with_the_one_that_is_meant(path: str, key: str, meant: str):
    data = mapping()
    inner = data
    for step in filter(None, path.split(".")):
        inner = inner[step]
    inner[key] = inner.pop(meant, {})
    with pytest.raises(CalibrationError, match=rf"{key} is no key of a calibration; write {meant}"):
        from_mapping(data)


def test_other_unknown_keys_are_ignored():
    data = mapping() | {"owner": "laboratory 3", "note": {"colour": "black"}}
    data["cameras"]["left"]["lens"] = "25 mm"
    assert from_mapping(data).baseline_mm == pytest.approx(500)


def test_a_volume_of_another_unit_or_place_is_refused():
    calibration = LAYOUT.calibration()
    with pytest.raises(CalibrationError, match=r"volume: its middle is 1\.4 mm away .* ratio 357, limits 0\.005 and 4"):
        check_volume(calibration.left, calibration.right, Volume(1.285, 1.515))
    with pytest.raises(CalibrationError, match="volume: the right camera sees nothing"):
        check_volume(calibration.left, calibration.right, Volume(300, 320))
