"""Areas that compare a rig.yaml with files and devices: options, library, cameras, calibration, timing."""

from __future__ import annotations

import json
import os
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pytest
import yaml

from daemon.apps.doctor.cameras import data_rate, elf, genicam_cameras, genicam_library, genicam_producers, v4l2_cameras
from daemon.apps.doctor.rig import calibration, display, exposure_timing, rig_file
from daemon.common.run_program import ProgramResult
from daemon.rig.calibration_file import read_calibration, write_calibration
from drivers.genicam import DetectedCamera
from drivers.projector.options import ProjectorOptions, read
from drivers.projector.x11.detected_output import DetectedOutput
from drivers.v4l2 import DetectedCamera as VideoFound
from drivers.v4l2.device import SupportedFormat
from sim.rig.layout import RigLayout
from tests.daemon.apps.doctor import fake_machines
from tests.daemon.apps.doctor.fake_machines import by_name, levels


def camera(serial: str, **changes: str) -> DetectedCamera:
    values = {"vendor": "V", "model": "M", "user_name": "", "version": "1", "transport": "U3V", "producer": "p"}
    return DetectedCamera(**(values | {"serial": serial, "access": "free"} | changes))


def matched(connected: list[DetectedCamera], left: dict[str, Any], right: dict[str, Any]) -> list[Any]:
    from drivers.genicam.options import parse

    found: list[Any] = []
    pair: dict[Any, DetectedCamera] = {}
    for side, options in (("left", parse("left", left)), ("right", parse("right", right))):
        found += genicam_cameras.camera_findings(side, options, connected, pair)  # type: ignore[arg-type]
    return found + list(genicam_cameras.pair(pair))


def test_a_rig_file_with_errors_is_checked_nevertheless(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(fake_machines.genicam("{serial: 4}", "{serial: A2, exposure: 3}"))
    config, problems = rig_file.read_leniently(path)
    assert config is not None and len(problems) == 3 and all("there is no file" in text for text in problems)
    subject = fake_machines.subject(tmp_path)
    subject.path, subject.config = path, config
    found = list(rig_file.check(subject))
    assert levels(found) == ["problem"] * 5
    assert f"{path}:1:35: cameras.left.serial" in found[3].text, found[3].text
    assert "cameras.right.exposure" in found[4].text


def test_a_file_that_is_no_rig_gives_errors_and_no_rig(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("camera: 5")
    config, problems = rig_file.read_leniently(path)
    assert config is None and problems
    assert rig_file.read_leniently(tmp_path / "none.yaml")[1][0].endswith("No such file or directory")


def test_a_missing_interpreter_library_is_reported_with_its_package() -> None:
    missing = ProgramResult(1, err="ImportError: libpython3.11.so.1.0: cannot open shared object file: No such file")
    found = genicam_library.import_finding("libpython3.11.so.1.0", missing, certain=True)
    assert found.level == "problem" and found.remedy == "sudo apt install libpython3.11"
    assert genicam_library.import_finding("", ProgramResult(-11), certain=False).level == "warning"
    assert genicam_library.import_finding("", ProgramResult(None), certain=True).text.endswith("does not end")


def test_elf_headers_are_read_without_loading() -> None:
    import numpy._core._multiarray_umath as compiled

    library = elf.read(Path(compiled.__file__))
    assert library.fits and "libc.so.6" in library.needed


def test_files_that_are_no_libraries_are_rejected(tmp_path: Path) -> None:
    whole = Path(os.path.realpath("/proc/self/exe")).read_bytes()
    (tmp_path / "cut").write_bytes(whole[:80])
    (tmp_path / "text").write_bytes(b"x" * 100)
    (tmp_path / "short").write_bytes(b"\x7fELF")
    for name in ("cut", "text", "short"):
        with pytest.raises(elf.ElfError):
            elf.read(tmp_path / name)
        assert genicam_producers.producer(tmp_path / name, certain=True).level == "problem"


def test_a_producer_for_another_processor_and_one_that_does_not_load_are_problems(tmp_path: Path) -> None:
    import numpy._core._multiarray_umath as compiled

    data = bytearray(Path(compiled.__file__).read_bytes())
    other = 62 if data[18] != 62 else 183
    data[18] = other
    (tmp_path / "other.cti").write_bytes(data)
    assert elf.MACHINES[other] in genicam_producers.producer(tmp_path / "other.cti", certain=True).text
    # A valid library, but no producer: the GenTL functions are missing.
    found = genicam_producers.producer(Path(compiled.__file__), certain=True)
    assert found.level == "problem" and "GCInitLib" in found.text and "ldd" in found.remedy


def test_missing_directories_of_the_environment_are_reported(tmp_path: Path) -> None:
    environ = {"GENICAM_GENTL64_PATH": f"{tmp_path}/none:{tmp_path}"}
    found = list(genicam_producers.check(fake_machines.subject(tmp_path, environ=environ)))
    assert levels(found) == ["warning", "warning", "note"]


def test_matching_cameras_are_ok() -> None:
    found = matched([camera("A1"), camera("A2")], {"serial": "A1"}, {"serial": "A2"})
    assert levels(found) == ["ok", "ok"] and "firmware 1" in found[0].text


@pytest.mark.parametrize(
    ("connected", "right", "level", "text"),
    [
        ([camera("A1")], {"serial": "A2"}, "problem", "is not connected"),
        ([camera("A1"), camera("A2"), camera("A3")], {"model": "M"}, "problem", "selects 3 cameras"),
        ([camera("A1"), camera("A2")], {"serial": "A1"}, "problem", "the same camera"),
        ([camera("A1"), camera("A2", version="2")], {"serial": "A2"}, "warning", "firmware"),
        ([camera("A1"), camera("A2", model="N")], {"serial": "A2"}, "warning", "right a N"),
        ([camera("A1"), camera("A2", access="in use")], {"serial": "A2"}, "warning", "in use"),
    ],
)
def test_mismatching_cameras_are_reported(
    connected: list[DetectedCamera], right: dict[str, Any], level: str, text: str
) -> None:
    wrong = [finding for finding in matched(connected, {"serial": "A1"}, right) if finding.level != "ok"]
    assert [finding.level for finding in wrong] == [level] and text in wrong[0].text


@pytest.mark.parametrize(
    ("options", "level", "text"),
    [
        ({"device": "S7", "format": "YUYV", "size": [640, 480]}, "ok", "S7"),
        ({"device": "/dev/video0"}, "ok", "Cam"),
        ({"device": "S8"}, "problem", "is not connected"),
        ({"device": "S7", "format": "RGGB"}, "problem", "does not offer RGGB"),
        ({"device": "S7", "size": [800, 600]}, "problem", "does not offer 800x600"),
    ],
)
def test_v4l2_cameras(options: dict[str, Any], level: str, text: str) -> None:
    from drivers.v4l2.options import from_mapping

    offers = (SupportedFormat("YUYV", "", ((640, 480), (1280, 720))),)
    connected = [VideoFound("/dev/v4l/by-id/x", "/dev/video0", "Cam", "uvcvideo", "usb-1", "S7", offers)]
    (found,) = v4l2_cameras.camera_findings("left", from_mapping("left", options), connected, {})
    assert found.level == level and text in found.text


def test_matching_calibration_pattern_and_volume_are_ok(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    found = list(
        calibration.check(
            fake_machines.subject(tmp_path, rig=fake_machines.genicam("{user_name: L}", "{user_name: R}"))
        )
    )
    assert {finding.level for finding in found if finding.name != "age"} == {"ok"}, found
    assert [finding.name for finding in found] == ["file", "age", "pattern", "volume", "layout"]


def test_a_calibration_of_other_cameras_is_reported(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    data = yaml.safe_load((tmp_path / "calibration.yaml").read_text())
    data["cameras"]["left"]["serial"] = "B7"
    (tmp_path / "calibration.yaml").write_text(yaml.safe_dump(data))
    rig = fake_machines.genicam("{serial: A1, roi: {width: 64, height: 48}}", "{user_name: R}")
    wrong = by_name(calibration.check(fake_machines.subject(tmp_path, rig=rig)), "camera left")
    assert levels(wrong) == ["problem", "problem"] and "64 x 48" in wrong[0].text and "B7" in wrong[1].text


def test_an_unreadable_calibration_does_not_hide_the_pattern(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    (tmp_path / "calibration.yaml").write_text("cameras: {")
    found = list(calibration.check(fake_machines.subject(tmp_path, rig=fake_machines.genicam())))
    assert [(finding.name, finding.level) for finding in found] == [("file", "problem"), ("pattern", "ok")]


def test_a_pattern_of_another_projector_and_a_volume_out_of_view_are_reported(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    (tmp_path / "volume.json").write_text('{"near_mm": 20.0, "far_mm": 40.0}')
    rig = fake_machines.genicam().replace("[160, 128]", "[1920, 1080]")
    found = list(calibration.check(fake_machines.subject(tmp_path, rig=rig)))
    assert by_name(found, "pattern")[0].level == "problem" and by_name(found, "volume")[0].level == "warning"


def test_a_pattern_of_another_size_than_the_calibrated_projector_is_reported(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    write_calibration(tmp_path / "calibration.yaml", RigLayout().scaled(0.25).calibration())
    (finding,) = by_name(calibration.check(fake_machines.subject(tmp_path, rig=fake_machines.genicam())), "pattern")
    assert finding.level == "problem" and "[160, 128] is not the size of the calibrated projector" in finding.text
    assert "[320, 256]" in finding.remedy


def test_a_rig_before_its_calibration_has_one_problem_with_the_command_to_calibrate(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text(fake_machines.genicam().replace(fake_machines.FILES, ""))
    subject = fake_machines.subject(tmp_path)
    subject.path, (subject.config, _) = path, rig_file.read_leniently(path)
    (finding,) = rig_file.check(subject)
    assert finding.level == "problem" and "no calibration, no pattern, no volume" in finding.text
    assert finding.remedy.startswith(f"fringed calibrate all {path}")
    assert [(one.name, one.level) for one in calibration.check(subject)] == [("file", "note")]


def test_a_projector_in_the_middle_is_reported_with_a_better_position(tmp_path: Path) -> None:
    layout = replace(RigLayout().scaled(0.125), projector_fraction=0.5)
    fake_machines.write_rig_files(tmp_path)
    write_calibration(tmp_path / "calibration.yaml", layout.calibration())
    (finding,) = by_name(calibration.check(fake_machines.subject(tmp_path, rig=fake_machines.genicam())), "layout")
    assert finding.level == "warning" and "0.382" in finding.remedy, finding


def test_a_narrow_field_that_hides_a_turn_of_the_right_camera_is_reported(tmp_path: Path) -> None:
    narrow = replace(RigLayout(), standoff_mm=1770.0, baseline_mm=340.0, projector_fraction=0.8, focal_px=4300.0)
    fake_machines.write_rig_files(tmp_path)
    write_calibration(tmp_path / "calibration.yaml", narrow.scaled(0.125).calibration())
    pattern = tmp_path / "pattern.json"
    pattern.write_text(json.dumps(json.loads(pattern.read_text()) | {"periods": 40.0}))
    (finding,) = by_name(calibration.check(fake_machines.subject(tmp_path, rig=fake_machines.genicam())), "hidden turn")
    assert finding.level == "warning" and "right camera turns by 0." in finding.text, finding


@pytest.mark.parametrize(
    ("rig", "mosaic"),
    [
        (fake_machines.genicam(right="{serial: A2, pixel_format: BayerRG8}"), True),
        (fake_machines.genicam(left="{serial: A1, pixel_format: RGB8}"), False),
        (fake_machines.genicam(), False),
        (fake_machines.v4l2("rggb"), True),
        (fake_machines.v4l2("RGB3"), False),
    ],
)
def test_fringes_that_are_too_narrow_for_a_mosaic_are_reported(tmp_path: Path, rig: str, mosaic: bool) -> None:
    fake_machines.write_rig_files(tmp_path)
    pattern = tmp_path / "pattern.json"
    settings = json.loads(pattern.read_text())
    assert not by_name(calibration.check(fake_machines.subject(tmp_path, rig=rig)), "fringes")
    pattern.write_text(json.dumps(settings | {"periods": 2 * settings["periods"]}))
    found = by_name(calibration.check(fake_machines.subject(tmp_path, rig=rig)), "fringes")
    assert levels(found) == ["warning"] * mosaic
    assert all("too narrow for a colour mosaic" in one.text and "show at most" in one.remedy for one in found)


def test_the_age_of_a_calibration(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    file = read_calibration(tmp_path / "calibration.yaml")
    stamp = datetime.fromisoformat(str(file.mapping["created"]))
    made = stamp.replace(tzinfo=stamp.tzinfo or UTC).timestamp()
    assert calibration.age(file, made + 86400.0).level == "ok"
    assert calibration.age(file, made + 200 * 86400.0).level == "warning"


def test_exposures_are_whole_numbers_of_periods() -> None:
    assert levels(exposure_timing.exposure_findings(60.0, {"left": 16666.7, "right": 16666.7})) == ["ok"]
    wrong = list(exposure_timing.exposure_findings(60.0, {"left": 10000.0, "right": 10000.0}))
    assert levels(wrong) == ["warning", "warning"] and "16667 us" in wrong[0].remedy
    assert levels(exposure_timing.exposure_findings(0.0, {"left": 1.0, "right": 2.0})) == ["warning", "note"]


def test_a_missing_exposure_is_a_warning(tmp_path: Path) -> None:
    fake_machines.write_rig_files(tmp_path)
    subject = fake_machines.subject(
        tmp_path, rig=fake_machines.genicam("{serial: A1}", "{serial: A2, exposure_us: 16666.7}")
    )
    found = list(exposure_timing.check(subject))
    assert levels(found) == ["warning", "ok"] and "cameras.left.exposure_us" in found[0].remedy


@pytest.mark.parametrize(("name", "size"), [("BayerRG8", 1), ("BayerRG12p", 1.5), ("Mono12", 2), ("RGB8", 3)])
def test_the_bytes_of_an_image(tmp_path: Path, name: str, size: float) -> None:
    fake_machines.write_rig_files(tmp_path)
    side = f"{{serial: A, pixel_format: {name}, roi: {{width: 100, height: 10}}}}"
    subject = fake_machines.subject(tmp_path, rig=fake_machines.genicam(side, side))
    assert data_rate.frame_bytes(subject) == [1000 * size, 1000 * size] and data_rate.rate_hz(subject) == 0.0


def test_an_output_in_the_wrong_mode_or_with_a_nonlinear_gamma_table() -> None:
    options = read(ProjectorOptions, {"output": "HDMI-1"})
    good = DetectedOutput(
        name="HDMI-1",
        connected=True,
        size=(912, 1140),
        refresh_hz=60.0,
        preferred_size=(912, 1140),
        gamma_identity=True,
    )
    assert levels(display.output_findings([good], options)) == ["ok", "ok"]
    import msgspec

    bad = msgspec.structs.replace(good, size=(1920, 1080), gamma_identity=False, refresh_hz=0.0)
    found = list(display.output_findings([bad], options))
    assert [(finding.name, finding.level) for finding in found] == [
        ("mode", "problem"),
        ("gamma", "problem"),
        ("refresh", "warning"),
    ]
    assert "xrandr --output HDMI-1 --mode 912x1140" in found[0].remedy
    (missing,) = display.output_findings([], options)
    assert missing.level == "problem" and "no such output" in missing.text
