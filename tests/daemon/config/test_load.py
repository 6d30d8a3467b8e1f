"""rig.yaml: every mistake at once, with line, column and a message."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.common.errors import ConfigError
from daemon.config import RigConfig, json_schema, load_rig, parse_rig
from daemon.config import json_schema as schema_module

GOOD = "cameras: {driver: sim}\n"


def problems(text: str) -> list[str]:
    with pytest.raises(ConfigError) as caught:
        parse_rig(text)
    return caught.value.problems


def test_a_rig_of_one_line_is_complete() -> None:
    config = parse_rig(GOOD)
    assert isinstance(config, RigConfig) and config.stream.endpoints[-1] == "tcp://127.0.0.1:5555"


def test_the_example_is_valid() -> None:
    load_rig(Path(__file__).parents[3] / "examples" / "rig.yaml")


def test_all_mistakes_are_reported_at_once_each_with_its_position() -> None:
    found = problems(
        "camras: {}\n"
        "cameras:\n"
        "  driver: smi\n"
        "pipeline:\n"
        "  threads: 1e3\n"
        "  settings: {min_modulatio: 3, consistency_threshold: a}\n"
        "volume: {near_mm: 5, far_mm: 3}\n"
    )
    places = [problem.split(": ")[0] for problem in found]
    assert places == [f"rig.yaml:{p}" for p in ("1:1", "3:11", "5:12", "6:29", "6:55", "7:30")]
    assert "did you mean 'cameras'" in found[0] and "did you mean 'sim'" in found[1]
    assert "write 1000" in found[2] and "min_modulation" in found[3]


def test_an_unknown_preset_and_a_wrong_setting_hide_no_other_mistake() -> None:
    found = problems(
        "cameras: {driver: sim}\n"
        "pipeline: {threds: 2, settings: {fusion_clouds: 0, roi_x_min_mm: 10, roi_x_max_mm: -10}}\n"
        "preset: nosuch\n"
    )
    places = [problem.split(": ")[0] for problem in found]
    assert places == [f"rig.yaml:{p}" for p in ("2:12", "2:33", "2:49", "3:9")]
    assert "did you mean 'threads'" in found[0] and "less than roi_x_max_mm" in found[1]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "empty"),
        ("cameras: {driver: sim\n", "YAML syntax"),
        (GOOD + "cameras: {driver: sim}\n", "defined twice, first in line 1"),
        (GOOD + "device: {name: 2020-01-01}\n", "reads as a date"),
        (GOOD + "stream: {allow_remote: 1}\n", "valid boolean"),
        (GOOD + "recording: {max_part_mb: 64.0}\n", "valid integer"),
        (GOOD + "stream: {preview_hz: .nan}\n", "not a finite number"),
        (GOOD + "stream: {endpoints: ['tcp://0.0.0.0:5555']}\n", "other machines"),
        (GOOD + "stream: {endpoints: ['udp://x']}\n", "not an address"),
        (GOOD + "control: {remote: ['ipc:///x']}\n", "not an address for other machines"),
        (GOOD + "security: {keys: nowhere}\n", "fringed keys server"),
        (GOOD + "security: {connections: 0}\n", "greater than or equal to 1"),
        (GOOD + "control: {endpoint: 'tcp://*:5556'}\n", "other machines"),
        (GOOD + "calibration: nowhere.yaml\n", "there is no file"),
        (GOOD + "1: 2\n", "not plain text"),
        ("[" * 300_000, "nested too deeply"),
        ("- " * 4000 + "x", "more than 20000 values or 32 levels"),
        ("- 1\n", "the file"),
        (GOOD + "pattern: {kind: stripes}\n", "stripes"),
        (GOOD + "pipeline: {overload: third}\n", "'skip' or 'half'"),
        (GOOD + "pipeline: {temporal_prior: 1}\n", "valid boolean"),
        (GOOD + "pipeline: {cpus: [2, 3, 2]}\n", "processor 2 is listed twice"),
        (GOOD + "pipeline: {cpus: [-1]}\n", "greater than or equal to 0"),
    ],
)
def test_a_mistake_has_its_message(text: str, message: str) -> None:
    assert any(message in problem for problem in problems(text))


def test_remote_addresses_need_an_explicit_setting() -> None:
    stream = "stream: {endpoints: ['tcp://0.0.0.0:5555']%s}\n"
    assert any("set stream.allow_remote: true and security.keys" in message for message in problems(GOOD + stream % ""))
    assert any("set security.keys" in message for message in problems(GOOD + stream % ", allow_remote: true"))
    control = "control: {remote: ['tcp://0.0.0.0:5556']}\n"
    assert any("set control.allow_remote: true and security.keys" in message for message in problems(GOOD + control))


def test_a_bomb_of_aliases_is_refused() -> None:
    bomb = "a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    bomb += "".join(f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12))
    assert any("more than" in problem for problem in problems(bomb))


def test_a_huge_file_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_bytes(b"#" * (1 << 21))
    with pytest.raises(ConfigError, match="at most"):
        load_rig(path)


def test_the_committed_schema_is_current() -> None:
    assert schema_module.COMMITTED.read_text(encoding="utf-8") == json_schema.text(), (
        "run python -m daemon.config.json_schema"
    )
