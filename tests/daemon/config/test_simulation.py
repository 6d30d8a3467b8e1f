"""Every mistake in the section of a simulated rig is reported in one go."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.common.errors import ConfigError
from daemon.config.load import load_rig, parse_rig

BAD = """\
device: {name: "a b"}
cameras: {driver: sim}
simulation:
  scene: nosuch
  frames: -3
  rate_hz: .inf
  layout: {scale: 1000, basline: 3}
  seed: -1
  poses: many
  faults: {script: [{kind: lost}, {kind: burn}, {kind: none}, {kind: drop, side: up}]}
  disturb: [{at: 1, side: top}]
pairing: {tolerance_us: .nan, max_wait_ms: -5}
"""
EXPECTED = (
    "rig.yaml:1:16: device.name",
    "rig.yaml:4:10: simulation.scene is 'nosuch'",
    "rig.yaml:5:11: simulation.frames is -3, expected 1 to 1000",
    "rig.yaml:6:12: simulation.rate_hz: .inf is not a finite number",
    "rig.yaml:7:19: simulation.layout.scale is 1000",
    "rig.yaml:7:34: simulation.layout.basline is not an option; did you mean 'baseline_mm'?",
    "rig.yaml:8:9: simulation.seed is -1",
    "rig.yaml:9:10: simulation.poses is 'many'",
    "rig.yaml:10:42: simulation.faults.script[1].kind is 'burn'",
    "rig.yaml:10:70: simulation.faults.script[3].kind is 'drop'",
    "rig.yaml:11:27: simulation.disturb[0].side is 'top'",
    "rig.yaml:12:25: pairing.tolerance_us: .nan is not a finite number",
    "rig.yaml:12:44: pairing.max_wait_ms: input should be greater than 0, got -5",
)


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigError) as raised:
        parse_rig(text)
    return raised.value.problems


def test_all_mistakes_are_reported_at_once_each_once_and_in_order() -> None:
    found = problems(BAD)
    assert len(found) == len(EXPECTED)
    for line, expected in zip(found, EXPECTED, strict=True):
        assert line.startswith(expected)


def test_a_misspelt_scene_does_not_hide_the_options_of_the_one_that_was_meant() -> None:
    text = "cameras: {driver: sim}\nsimulation: {scene: bord, board: 'circles:0x9', live: true, poses: 0}\n"
    named = [line.split(": ", 1)[1].split()[0].rstrip(":") for line in problems(text)]
    assert named == ["simulation.scene", "simulation.board", "simulation.poses"]


def test_a_section_without_keys_and_other_drivers_are_left_alone(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text("cameras: {driver: sim}\nsimulation: {}\n")
    assert load_rig(tmp_path / "rig.yaml").simulation == {}
    assert not any("simulation" in line for line in problems("cameras: {driver: x}\nsimulation: {scene: nosuch}\n"))
