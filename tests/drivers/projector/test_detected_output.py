"""Which outputs are fit for exact pixels, and the problems of those that are not."""

from __future__ import annotations

from typing import Any

import msgspec
import numpy as np
import pytest

from drivers.projector.x11.detected_output import DetectedOutput, gamma_problem, mode_problem, output_problem
from drivers.projector.x11.edid import monitor_name
from drivers.projector.x11.randr import DOUBLE_SCAN, INTERLACE, identity, is_identity, refresh_hz
from drivers.projector.x11.randr_structures import ModeInfo

GOOD = DetectedOutput(
    name="HDMI-1",
    connected=True,
    size=(1280, 800),
    mode_size=(1280, 800),
    preferred_size=(1280, 800),
    refresh_hz=60 / 1.001,
    gamma_identity=True,
)
ASKED: dict[str, Any] = {"native": True, "size": (1280, 800), "refresh_hz": 59.94}


def changed(**values: Any) -> DetectedOutput:
    return msgspec.structs.replace(GOOD, **values)


def test_a_good_output_is_fit() -> None:
    assert mode_problem(GOOD, **ASKED) == gamma_problem(GOOD) == output_problem([GOOD], "HDMI-1") == ""


@pytest.mark.parametrize(
    ("output", "complaint"),
    [
        (changed(rotation="left"), "is rotated"),
        (changed(rotation="normal, reflected"), "is rotated"),
        (changed(scaled=True), "is scaled"),
        (changed(size=(1024, 768)), "is 1024x768, expected 1280x800"),
        (changed(preferred_size=(912, 1140)), "own resolution is 912x1140"),
        (changed(refresh_hz=60.0), "refreshes at 60.000 Hz, expected 59.94 Hz"),
        (changed(refresh_hz=0.0), "refreshes at 0.000 Hz"),
    ],
)
def test_an_unfit_output_is_refused_by_name(output: DetectedOutput, complaint: str) -> None:
    reason = mode_problem(output, **ASKED)
    assert complaint in reason and "HDMI-1" in reason


def test_another_mode_is_taken_when_any_is_asked_for_and_when_none_is_preferred() -> None:
    small = changed(size=(640, 480))
    assert mode_problem(small, native=False, size=None, refresh_hz=None) == ""
    assert mode_problem(changed(size=(640, 480), preferred_size=None), native=True, size=None, refresh_hz=None) == ""


@pytest.mark.parametrize(
    ("found", "complaint"),
    [
        ([], "no such output on this display; there are: none"),
        ([changed(name="DP-1")], "no such output on this display; there are: DP-1"),
        ([changed(connected=False)], "is not connected"),
        ([changed(size=(0, 0))], "switched off; run: xrandr --output HDMI-1 --auto"),
    ],
)
def test_an_absent_output_is_reported_with_the_usable_ones(found: list[DetectedOutput], complaint: str) -> None:
    assert complaint in output_problem(found, "HDMI-1")


def test_only_a_table_known_to_be_bent_is_refused() -> None:
    assert "gamma" in gamma_problem(changed(gamma_identity=False))
    assert gamma_problem(changed(gamma_identity=None)) == ""


@pytest.mark.parametrize("size", [2, 256, 1024, 4096])
def test_linear_tables_are_identities_however_rounded_and_others_are_not(size: int) -> None:
    table = identity(size)
    assert is_identity(table) and is_identity(table & 0xFF00)
    assert not is_identity((65535 * (table / 65535.0) ** 1.05).astype(np.uint16)) or size == 2
    assert not is_identity(table // 2)
    assert not is_identity(table[:, ::-1])


def test_the_refresh_rate_comes_from_the_timings() -> None:
    hd = ModeInfo(dot_clock=148_351_648, h_total=2200, v_total=1125)
    assert refresh_hz(hd) == pytest.approx(60 / 1.001, abs=1e-4)
    hd.flags = INTERLACE
    assert refresh_hz(hd) == pytest.approx(2 * 60 / 1.001, abs=1e-4)
    hd.flags = DOUBLE_SCAN
    assert refresh_hz(hd) == pytest.approx(30 / 1.001, abs=1e-4)
    assert refresh_hz(ModeInfo()) == 0.0


def edid(descriptor: bytes = b"") -> bytes:
    block = bytearray(128)
    block[:8] = bytes([0, 255, 255, 255, 255, 255, 255, 0])
    block[8:12] = bytes([0x16, 0x13, 0x0A, 0x0C])  # EPS, 0x0C0A
    block[72 : 72 + len(descriptor)] = descriptor
    return bytes(block)


def test_the_name_is_read_from_an_edid() -> None:
    assert monitor_name(edid(b"\0\0\0\xfc\0EPSON PJ\n    ")) == "EPSON PJ"
    assert monitor_name(edid(b"\0\0\0\xfc\0THIRTEENCHARS")) == "THIRTEENCHARS"
    assert monitor_name(edid()) == "EPS 0C0A"


@pytest.mark.parametrize("broken", [b"", b"\0" * 128, edid()[:127], b"x" * 1000])
def test_what_is_no_edid_has_no_name(broken: bytes) -> None:
    assert monitor_name(broken) == ""
