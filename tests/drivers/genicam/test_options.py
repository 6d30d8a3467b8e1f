"""Options are checked before a camera is touched, and mistakes are named by their key."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.genicam import open_camera
from drivers.genicam.options import PRODUCER_PATH, Trigger, parse, producers

GOOD: dict[str, Any] = {"producer": __file__, "serial": "A1"}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"exposure_us": "2000"}, r"cameras\.left\.exposure_us: Expected"),
        ({"exposure_us": -1}, r"cameras\.left\.exposure_us: Expected .*> 0"),
        ({"exposure_us": float("nan")}, r"cameras\.left\.exposure_us"),
        ({"exposure_us": True}, r"cameras\.left\.exposure_us"),
        ({"gain": float("inf")}, r"cameras\.left\.gain"),
        ({"exposure": 1}, r"cameras\.left\.exposure: .*unknown field"),
        ({"trigger": {"edge": "up"}}, r"cameras\.left\.trigger\.edge: Invalid enum value 'up'"),
        ({"trigger": {"lines": "Line1"}}, r"cameras\.left\.trigger\.lines"),
        ({"trigger": "Line1"}, r"cameras\.left\.trigger: Expected `object`"),
        ({"roi": {"width": 10}}, r"cameras\.left\.roi: .*height"),
        ({"roi": {"width": 0, "height": 1}}, r"cameras\.left\.roi\.width"),
        ({"buffers": 1}, r"cameras\.left\.buffers"),
        ({"features": {"A": [1]}}, r"cameras\.left\.features"),
        ({"serial": None}, r"cameras\.left\.serial: name the camera"),
        ({"producer": "/nowhere/x.cti"}, r"cameras\.left\.producer: there is no GenTL producer /nowhere/x\.cti"),
    ],
)
def test_mistakes_are_named(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        open_camera("left", {**GOOD, **changes}, Path("/"))


def test_good_options_are_taken_and_nothing_is_started() -> None:
    camera = open_camera("right", {**GOOD, "exposure_us": 2000, "features": {"A": 1, "B": "x", "C": True}}, Path("/"))
    assert camera.health().counters["processes"] == 0
    camera.close()
    assert parse("left", GOOD).trigger == Trigger(source="line", line="Line1", edge="rising", selector="FrameStart")


def test_producers_come_from_the_standard_variable(tmp_path: Path) -> None:
    for name in ("b.cti", "a.cti", "c.so"):
        (tmp_path / name).touch()
    environ = {PRODUCER_PATH: f"/nowhere:{tmp_path}"}
    assert producers(None, Path("/"), environ) == [tmp_path / "a.cti", tmp_path / "b.cti"]
    with pytest.raises(ValueError, match=f"set producer .* or {PRODUCER_PATH}"):
        producers(None, Path("/"), {})


def test_paths_are_relative_to_the_rig_file(tmp_path: Path) -> None:
    (tmp_path / "a.cti").touch()
    assert producers("a.cti", tmp_path) == [tmp_path / "a.cti"]
    assert producers(["a.cti"], tmp_path) == [tmp_path / "a.cti"]
    with pytest.raises(FileNotFoundError):
        producers(["a.cti", "b.cti"], tmp_path)
