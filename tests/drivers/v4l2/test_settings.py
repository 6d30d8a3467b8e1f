"""Formats, sizes, controls and frame rates: actual values, and notes of deviations."""

from __future__ import annotations

import errno

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import SettingRefused
from drivers.v4l2 import structs as v
from drivers.v4l2.controls import Kind, normalised
from tests.drivers.v4l2.cameras import opened
from tests.drivers.v4l2.fake import FakeControl, FakeKernel, exposure_controls


def test_the_best_format_for_measuring_is_chosen() -> None:
    offered = {"MJPG": [(32, 16)], "GREY": [(32, 16)], "YUYV": [(32, 16)], "H264": [(32, 16)]}
    assert opened(FakeKernel(offered)).encoding == "rgb8"
    assert opened(FakeKernel({**offered, "GBRG": [(32, 16)]})).encoding == "bayer_gbrg8"
    assert opened(FakeKernel(offered), format="GREY").encoding == "mono8"
    notes = opened(FakeKernel({"RG12": [(32, 16)]})).notes
    assert any("12 bits are reduced to 8" in note for note in notes)


def test_formats_and_sizes_that_are_not_there_are_refused_with_those_there_are() -> None:
    kernel = FakeKernel({"GREY": [(32, 16), (64, 48)]})
    with pytest.raises(SettingRefused, match="GREY 32x16, 64x48"):
        opened(kernel, size=[640, 480])
    with pytest.raises(SettingRefused, match="does not offer the format YUYV; there are: GREY"):
        opened(kernel, format="YUYV")
    with pytest.raises(SettingRefused, match="none of the formats of Fake camera is supported: H264"):
        opened(FakeKernel({"H264": [(32, 16)]}))
    assert not kernel.fds


def test_switches_are_set_before_values() -> None:
    kernel = FakeKernel(controls=exposure_controls(mode=3))
    info = opened(kernel, controls={"exposure_time_absolute": 50, "auto_exposure": "manual mode"})
    assert kernel.set_order == ["Auto Exposure", "Exposure Time, Absolute"]
    assert info.exposure_us == 5000


@pytest.mark.parametrize("entry", ["manual", "Manual Mode", "manual_mode", 1])
def test_menus_take_names_and_numbers(entry: str | int) -> None:
    kernel = FakeKernel(controls=exposure_controls(mode=3))
    opened(kernel, controls={"auto_exposure": entry})
    assert kernel.controls[v.CID_EXPOSURE_AUTO].value == 1


@pytest.mark.parametrize("entry", ["bright", 2, "mode"])
def test_menu_entries_that_are_not_there_are_refused_with_those_there_are(entry: str | int) -> None:
    with pytest.raises(SettingRefused, match="Manual Mode \\(1\\)"):
        opened(FakeKernel(controls=exposure_controls()), controls={"auto_exposure": entry})


def test_an_unknown_control_is_refused_with_those_there_are() -> None:
    with pytest.raises(SettingRefused, match="did you mean exposure_time_absolute") as caught:
        opened(FakeKernel(controls=exposure_controls()), controls={"exposure_absolute": 5})
    assert "auto_exposure" in str(caught.value)


@pytest.mark.parametrize(
    ("control", "value", "message"),
    [
        (FakeControl(5, "Gain", value=7), 900, "the camera uses 255; 0 to 255"),
        (FakeControl(5, "Gain", value=7, flags=v.CTRL_FLAG_READ_ONLY), 3, "refused (it is read-only"),
        (FakeControl(5, "Gain", value=7, flags=v.CTRL_FLAG_INACTIVE), 3, "makes it inactive"),
    ],
)
def test_deviations_are_notes(control: FakeControl, value: int, message: str) -> None:
    notes = opened(FakeKernel(controls=[control]), controls={"gain": value}).notes
    assert any(message in note for note in notes), notes


@pytest.mark.parametrize("number", [errno.EBUSY, errno.ERANGE, errno.EINVAL, errno.EIO, errno.EPIPE])
def test_a_refused_control_is_a_note_with_the_value_it_has(number: int) -> None:
    kernel = FakeKernel(controls=[FakeControl(5, "Gain", value=7)])
    kernel.errors[v.S_CTRL].append(number)
    notes = opened(kernel, controls={"gain": 3}).notes
    assert any("gain: 3 was refused" in note and "it is 7" in note for note in notes), notes


def test_controls_of_all_kinds_are_set() -> None:
    kernel = FakeKernel(
        controls=[
            FakeControl(1, "Trigger Mode", Kind.BOOLEAN, 0, 1),
            FakeControl(2, "Power Line", Kind.INTEGER_MENU, 0, 2, menu={0: "0", 1: "50", 2: "60"}),
            FakeControl(3, "Mask", Kind.BITMASK, 0, 255),
        ]
    )
    info = opened(kernel, controls={"trigger_mode": True, "power_line": "60", "mask": 5})
    assert [control.value for control in kernel.controls.values()] == [1, 2, 5]
    assert info.notes == ()


def test_the_frame_rate_that_it_took_is_a_note_unless_it_is_the_one_asked_for() -> None:
    assert not any("frame_rate" in note for note in opened(FakeKernel(rates_hz=(15, 30)), frame_rate_hz=30).notes)
    notes = opened(FakeKernel(rates_hz=(15, 30)), frame_rate_hz=25).notes
    assert "frame_rate_hz: 25 was requested, the camera uses 30" in notes
    assert any("has no frame rate setting" in note for note in opened(FakeKernel(), frame_rate_hz=25).notes)


def test_an_automatic_exposure_is_unknown_and_noted() -> None:
    info = opened(FakeKernel(controls=exposure_controls(mode=3)))
    assert info.exposure_us == 0 and any("automatic" in note for note in info.notes)


def test_the_trigger_is_noted() -> None:
    trigger = [FakeControl(1, "Trigger Mode", Kind.BOOLEAN, 0, 1)]
    assert any("set trigger_mode in controls" in note for note in opened(FakeKernel(controls=trigger)).notes)
    assert opened(FakeKernel(controls=trigger), controls={"trigger_mode": True}).notes == ()
    assert any("none of its controls" in note for note in opened(FakeKernel()).notes)
    still = opened(FakeKernel(), trigger="software", only_still_scenes=True)
    assert any("by chance only" in note for note in still.notes)


@given(name=st.text(max_size=40))
def test_names_are_letters_digits_and_single_underscores(name: str) -> None:
    short = normalised(name)
    assert normalised(short) == short
    assert not short.startswith("_") and "__" not in short and short == short.lower()


def test_names_are_those_of_v4l2_ctl() -> None:
    assert normalised("White Balance Temperature, Auto") == "white_balance_temperature_auto"
    assert normalised("Exposure (Absolute)") == "exposure_absolute"
