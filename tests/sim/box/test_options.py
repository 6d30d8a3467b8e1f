"""Options of a box are checked before anything is started; the rig's files describe the box."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml

from daemon.config import load_rig
from daemon.rig.pattern_file import read_pattern, read_volume
from drivers.protocols import SIDES
from sim.box.options import BoxOptions, fitted, read
from sim.box.rig_files import RigAddresses, write_rig
from sim.devices.options import OptionError
from sim.rig.layout import RigLayout
from sim.rig.optics import Optics

MISTAKES = {
    "exposure: 3": "box.exposure is not an option; did you mean 'exposure_us'?",
    "exposure_us: -1": "box.exposure_us is -1, expected a number from 10 to 1e+06",
    "tcp: 5555.5": "box.tcp is 5555.5, expected a whole number",
    "tcp: true": "box.tcp is True, expected a number from 0 to 65535",
    "daemon: maybe": "box.daemon is 'maybe', expected true or false",
    "simulation: {scene: plain}": "sim.scene is 'plain', expected one of",
    "simulation: 3": "box.simulation is 3, expected a mapping",
    "simulation: {rate_hz: 0}": "box.simulation.rate_hz is 0, expected more than 0",
    "drift_ppm: {left: 2000.0}": "box.drift_ppm.left is 2000.0",
    "drift_ppm: {left: fast}": "box.drift_ppm is {'left': 'fast'}, expected numbers",
    "drift_ppm: {centre: 1}": "box.drift_ppm.centre is not an option",
    "[]": "box is [], expected a mapping",
    "{": "while parsing",
}


@pytest.mark.parametrize("text", MISTAKES)
def test_mistakes_are_reported_with_file_and_key(tmp_path: Path, text: str) -> None:
    path = tmp_path / "box.yaml"
    path.write_text(text)
    with pytest.raises(OptionError) as error:
        read(path)
    assert str(error.value).startswith(f"{path}: {MISTAKES[text]}")


def test_an_empty_file_is_the_standard_box(tmp_path: Path) -> None:
    path = tmp_path / "box.yaml"
    path.write_text("")
    assert read(path) == BoxOptions()
    assert len(BoxOptions().instants_s) == BoxOptions().simulation.frames


@pytest.mark.parametrize("scale", [0.0625, 0.125, 0.25, 0.3, 1.0])
def test_sizes_fit_the_devices(scale: float) -> None:
    layout = RigLayout().scaled(scale)
    made = fitted(layout)
    assert made.camera_size[0] % 4 == made.camera_size[1] % 2 == made.projector_size[0] % 8 == 0
    for got, wanted in ((made.camera_size, layout.camera_size), (made.projector_size, layout.projector_size)):
        assert all(0 <= w - g < 8 for g, w in zip(got, wanted, strict=True))


def test_the_daemon_reads_what_is_written(tmp_path: Path) -> None:
    layout, serials = fitted(RigLayout().scaled(0.25)), {side: f"S-{side}" for side in SIDES}
    places = RigAddresses(tmp_path / "made.cti", serials, ":7", "DUMMY1")
    path = write_rig(
        tmp_path / "rig",
        layout,
        Optics(),
        places,
        pixel_format="RGB8",
        exposure_us=500.0,
        extra={"pipeline": {"queue": 2}},
    )
    config = load_rig(path)
    assert config.cameras.driver == "genicam" and config.pipeline.queue == 2
    assert config.cameras.left["serial"] == "S-left" and config.cameras.right["exposure_us"] == 500.0
    assert config.projector is not None and config.projector.options == {"output": "DUMMY1", "display": ":7"}
    assert read_pattern(path.parent / "pattern.json").size == layout.projector_size
    assert read_volume(path.parent / "volume.json").near_mm == layout.volume().near_mm
    calibration = yaml.safe_load((path.parent / "calibration.yaml").read_text())
    assert [calibration["cameras"][side]["serial"] for side in SIDES] == ["S-left", "S-right"]
    assert json.loads((path.parent / "pattern.json").read_text())
