"""Options of the projectors: right ones are taken, each wrong one is named as it stands in rig.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from drivers.errors import DriverError
from drivers.projector import open_external, open_projector
from drivers.protocols import Projector

HERE = Path()
RIGHT = {"output": "HDMI-1"}


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        ({}, "projector.output: is missing"),
        ({"output": 3}, "projector.output: expected `str`, got `int`"),
        ({"output": " "}, "projector.output: empty"),
        ({**RIGHT, "outptu": "HDMI-1"}, "projector.outptu: no such option"),
        ({**RIGHT, "mode": "other"}, "projector.mode: "),
        ({**RIGHT, "gamma": "2.2"}, "projector.gamma: "),
        ({**RIGHT, "size": [640]}, "projector.size: "),
        ({**RIGHT, "size": [0, 480]}, r"projector.size: \[0, 480\], expected 1 to 8192"),
        ({**RIGHT, "refresh_hz": -1.0}, "projector.refresh_hz: -1.0"),
        ({**RIGHT, "refresh_hz": float("nan")}, "projector.refresh_hz: nan"),
        ({**RIGHT, "show_timeout_s": 0.0}, "projector.show_timeout_s: 0.0"),
        ({**RIGHT, "latency_ms": 1.0, "latency_frames": 1.0}, "projector.latency_ms: latency_frames is given too"),
        ({**RIGHT, "latency_ms": -1.0}, "projector.latency_ms: -1.0"),
        ({**RIGHT, "hook": {"open": ["xset"]}}, r"projector.hook.open\[0\]: expected `array`"),
        ({**RIGHT, "hook": {"open": [[]]}}, r"projector.hook.open\[0\]: expected a program"),
        ({**RIGHT, "hook": {"show": [["true"]] * 17}}, "projector.hook.show: 17 commands, expected at most 16"),
        ({**RIGHT, "hook": {"timeout_s": 0.0}}, "projector.hook.timeout_s: 0.0"),
        ({**RIGHT, "hook": {"opne": []}}, "projector.hook.opne: no such option"),
    ],
)
def test_a_wrong_option_is_named(options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        open_projector(options, HERE)


@pytest.mark.parametrize(
    ("options", "complaint"),
    [({}, "projector.size: is missing"), ({"size": [8, 8], "output": "x"}, "projector.output: no such option")],
)
def test_a_wrong_option_of_an_external_projector_is_named(options: dict[str, Any], complaint: str) -> None:
    with pytest.raises(ValueError, match=complaint):
        open_external(options, HERE)


def test_both_are_projectors_and_closed() -> None:
    for projector in (open_projector(RIGHT, HERE), open_external({"size": [8, 8]}, HERE)):
        assert isinstance(projector, Projector)
        assert "closed" in projector.problem()
        projector.close()
        projector.close()


def test_without_a_display_the_option_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    with pytest.raises(DriverError, match=r"projector\.options\.display"):
        open_projector(RIGHT, HERE).open()


@pytest.mark.parametrize(
    ("options", "latency_s"),
    [({}, None), ({"latency_ms": 40.0}, 0.04), ({"latency_frames": 2.0, "refresh_hz": 50.0}, 0.04)],
)
def test_the_stored_latency_is_returned_in_seconds(options: dict[str, Any], latency_s: float | None) -> None:
    projector = open_external({"size": [8, 8], **options}, HERE)
    assert projector.open().latency_s == (None if latency_s is None else pytest.approx(latency_s))
