"""Change of one value in a file: everything else stays byte for byte."""

from __future__ import annotations

import pytest
import yaml

from daemon.common.errors import DaemonError
from daemon.config.yaml_edit import with_value

KEY = ("projector", "options", "latency_ms")
BLOCK = (
    "# mine\nprojector:\n  driver: x11 # the window\n  options:\n    output: HDMI-1   # left of the bench\n"
    "{more}device: {{name: a}}\n"
)


@pytest.mark.parametrize(
    "text",
    [
        BLOCK.format(more=""),
        BLOCK.format(more="    latency_ms: 1.0 # old\n"),
        "projector: {driver: x11, options: {output: HDMI-1}} # flow\n",
        "projector: {driver: x11, options: {latency_ms: 3, output: HDMI-1}}\n",
        "projector: {driver: external, options: {}}\n",
        "projector:\n  options: {output: A}\n  driver: x11\n",
    ],
)
def test_only_the_value_changes(text: str) -> None:
    changed = with_value(text, KEY, 33.42)
    wanted = yaml.safe_load(text)
    wanted["projector"]["options"]["latency_ms"] = 33.42
    assert yaml.safe_load(changed) == wanted
    assert with_value(changed, KEY, 33.42) == changed
    kept = [line for line in text.splitlines() if "latency_ms" not in line and "options: {" not in line]
    assert [line for line in changed.splitlines() if line in kept] == kept
    assert [part.partition("#")[2] for part in changed.splitlines() if "#" in part] == [
        part.partition("#")[2] for part in text.splitlines() if "#" in part
    ]


def test_missing_sections_and_unsupported_layouts_are_reported() -> None:
    with pytest.raises(DaemonError, match=r"no section projector\.options"):
        with_value("device: {name: a}\n", KEY, 1.0)
    anchored = "a: &x {output: A}\nprojector: {options: *x}\n"
    with pytest.raises(DaemonError, match=r"latency_ms cannot be set by itself .* write latency_ms: 1 there"):
        with_value(anchored, KEY, 1.0)


@pytest.mark.parametrize("value", [True, "half", "off", "a b", 3, 0.123456789, [1, 2]])
@pytest.mark.parametrize(
    "text",
    [
        "# mine\ncameras: {driver: sim} # kept\n",
        "cameras: {driver: sim}\npipeline:\n  threads: 0 # all\n",
        "pipeline: {settings: {lattice_x: 3}} # flow\ncameras: {driver: sim}\n",
        "pipeline:\n  # settings\n  settings:\n    wanted: 1 # old\n",
    ],
)
def test_missing_sections_are_made(text: str, value: object) -> None:
    changed = with_value(text, ("pipeline", "settings", "wanted"), value, create=True)
    wanted = yaml.safe_load(text)
    wanted.setdefault("pipeline", {}).setdefault("settings", {})["wanted"] = value
    assert yaml.safe_load(changed) == wanted
    assert [line.partition("#")[2] for line in changed.splitlines() if "#" in line] == [
        line.partition("#")[2] for line in text.splitlines() if "#" in line
    ]
