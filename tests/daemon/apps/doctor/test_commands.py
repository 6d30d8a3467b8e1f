"""The commands on emulated cameras, a real X server and this machine."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from daemon.apps.doctor import device_inventory
from daemon.apps.doctor.cameras import genicam_cameras, genicam_library, genicam_producers
from daemon.apps.doctor.check_table import AREAS
from daemon.apps.doctor.subject import Subject
from daemon.cli.entry import run
from sim.box.xserver import XServer
from sim.gentl.cable import Cable
from tests.daemon.apps.doctor import fake_machines

Fringed = Callable[..., subprocess.CompletedProcess[str]]
NOT_NEEDED = "library", "producers", "cameras", "v4l2", "usb", "network", "display"


def sim_rig(directory: Path) -> Path:
    path = directory / "rig.yaml"
    path.write_text(
        "cameras: {driver: sim}\nsimulation: {frames: 2, rate_hz: 4.0, layout: {scale: 0.125}}\n"
        f"stream: {{endpoints: ['ipc://{directory}/s', 'tcp://127.0.0.1:*']}}\n"
        f"control: {{endpoint: 'ipc://{directory}/c'}}\nrecording: {{min_free_mb: 0}}\n"
    )
    return path


def hardware_rig(directory: Path, producer: Path, display: str, *, right: str = "A2") -> Path:
    fake_machines.write_rig_files(directory)
    camera = f"producer: '{producer}', exposure_us: 16683.4, pixel_format: BayerRG8"
    path = directory / "rig.yaml"
    path.write_text(
        f"cameras:\n  driver: genicam\n  left: {{user_name: '', model: FringedCam, serial: A1, {camera}}}\n"
        f"  right: {{serial: {right}, {camera}}}\n"
        f"projector: {{driver: x11, options: {{output: DUMMY1, display: '{display}', refresh_hz: 59.94}}}}\n"
        f"stream: {{endpoints: ['ipc://{directory}/s']}}\ncontrol: {{endpoint: 'ipc://{directory}/c'}}\n"
        "recording: {min_free_mb: 0}\n" + fake_machines.FILES
    )
    path.write_text(path.read_text().replace("user_name: '', ", ""))
    return path


def findings(report: dict[str, Any], area: str) -> list[dict[str, str]]:
    return [finding for finding in report["findings"] if finding["area"] == area]


def test_a_simulated_rig_is_healthy_and_the_json_has_its_shape(fringed: Fringed, tmp_path: Path) -> None:
    rig = sim_rig(tmp_path)
    process = fringed("doctor", str(rig), "--json")
    report = json.loads(process.stdout)
    assert process.returncode == 0 and report["healthy"] is True, process.stdout + process.stderr
    assert set(report) == {"rig", "healthy", "counts", "findings"} and report["rig"] == str(rig)
    assert list(report["counts"]) == ["ok", "note", "warning", "problem"] and report["counts"]["problem"] == 0
    assert all(set(finding) == {"area", "name", "level", "text", "remedy"} for finding in report["findings"])
    assert list(dict.fromkeys(finding["area"] for finding in report["findings"])) == [check.area for check in AREAS]
    for area in NOT_NEEDED:
        assert [finding["text"] for finding in findings(report, area)] == ["not needed with sim"]


def test_areas_that_are_not_needed_take_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    only = (option for area in (*NOT_NEEDED, "disk") for option in ("--only", area))
    assert run(["doctor", str(sim_rig(tmp_path)), *only]) == 0
    output = capsys.readouterr().out
    assert output.count("not needed") == 1 and "\x1b" not in output
    assert all(len(line) <= 110 for line in output.splitlines() if "://" not in line)


def test_a_rig_of_emulated_cameras_and_an_x_server(
    fringed: Fringed, tmp_path: Path, producer: Path, cables: tuple[Cable, Cable], server: XServer
) -> None:
    assert cables[0] is not cables[1]
    process = fringed("doctor", str(hardware_rig(tmp_path, producer, server.display)), "--json")
    report = json.loads(process.stdout)
    for area, text in (
        ("library", "harvesters"),
        ("producers", str(producer)),
        ("cameras", "left: Fringed FringedCam, A1, firmware"),
        ("cameras", "right: Fringed FringedCam, A2, firmware"),
        ("display", "DUMMY1 320x256@59.94, its native resolution"),
        ("display", "the gamma table is linear"),
        ("timing", "16683 us are 1.00 periods of 59.9"),
    ):
        assert any(text in f["text"] and f["level"] == "ok" for f in findings(report, area)), (
            area,
            text,
            process.stdout,
        )
    # The simulated calibration belongs to other cameras and another projector, which must be reported.
    problems = [finding["text"] for finding in report["findings"] if finding["level"] == "problem"]
    assert process.returncode == 1 and any("the calibration was made with sim-left" in text for text in problems)
    assert {finding["area"] for finding in report["findings"] if finding["level"] == "problem"} == {"calibration"}


def test_a_missing_camera_is_reported_with_the_connected_ones(
    tmp_path: Path, producer: Path, cables: tuple[Cable, Cable]
) -> None:
    cables[1].unplug()
    fake_machines.write_rig_files(tmp_path)
    rig = fake_machines.genicam(f"{{serial: A1, producer: '{producer}'}}", f"{{serial: A2, producer: '{producer}'}}")
    subject = fake_machines.subject(tmp_path, rig=rig)
    found = list(genicam_cameras.check(subject))
    assert [(finding.name, finding.level) for finding in found] == [("camera left", "ok"), ("camera right", "problem")]
    assert "A1" in found[1].text


def test_the_environments_producer_is_detected_and_loads(
    tmp_path: Path, producer: Path, cables: tuple[Cable, Cable]
) -> None:
    assert len(cables) == 2
    subject = fake_machines.subject(tmp_path, environ={"GENICAM_GENTL64_PATH": str(producer.parent)})
    assert [finding.level for finding in genicam_producers.check(subject)] == ["ok"]
    assert [finding.level for finding in genicam_cameras.check(subject)] == ["ok", "ok"]


def test_the_genicam_library_of_this_machine(tmp_path: Path, producer: Path) -> None:
    assert producer.is_file()  # the fixture skips machines without the library
    (found,) = genicam_library.check(fake_machines.subject(tmp_path))
    library = genicam_library.needed_python(genicam_library.package_dir("genicam"))
    assert library.startswith("libpython3.")
    assert (found.level, library in found.text) in {("ok", True), ("warning", True)}


def test_a_missing_x_server_is_a_problem_of_rigs_that_need_it(tmp_path: Path) -> None:
    from daemon.apps.doctor.rig import display

    fake_machines.write_rig_files(tmp_path)
    rig = fake_machines.genicam().replace(
        "external, options: {size: [160, 128], refresh_hz: 60.0}", "x11, options: {output: A}"
    )
    subject = fake_machines.subject(tmp_path, rig=rig.replace("output: A", "output: A, display: ':4711'"))
    (found,) = display.check(subject)
    assert found.level == "problem" and ":4711" in found.text


def test_programs_that_interfere_with_the_image_are_named(
    tmp_path: Path, server: XServer, monkeypatch: pytest.MonkeyPatch
) -> None:
    from daemon.apps.doctor.rig import display

    monkeypatch.setenv("DISPLAY", server.display)
    machine = fake_machines.machine(tmp_path, {"/proc/12/comm": "redshift"}, {"XDG_SESSION_TYPE": "wayland"})
    found = list(display.check(Subject(machine)))
    assert [finding.name for finding in found] == ["server", "wayland", "meddler", "surroundings"]
    assert "kill 12" in found[2].remedy


def test_devices_lists_what_rig_yaml_needs(
    fringed: Fringed, producer: Path, cables: tuple[Cable, Cable], server: XServer,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    assert len(cables) == 2
    arguments = "--producer", str(producer), "--display", server.display
    plain = fringed("devices", *arguments)
    assert plain.returncode == 0, plain.stderr
    assert run(["devices", "--json", *arguments]) == 0
    for text in ("serial: A1", "serial: A2", "model: FringedCam", "output: DUMMY1   size: [320, 256]", str(producer)):
        assert text in plain.stdout
    report = json.loads(capsys.readouterr().out)
    assert [camera["serial"] for camera in report["genicam"]] == ["A1", "A2"]
    assert [output["name"] for output in report["outputs"]] == ["DUMMY0", "DUMMY1"]
    assert report["outputs"][1]["refresh_hz"] == pytest.approx(59.94, abs=0.03)


def test_an_inventory_without_devices_reports_the_reasons(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("GENICAM_GENTL64_PATH", raising=False)
    monkeypatch.delenv("DISPLAY", raising=False)
    found = device_inventory.inventory()
    assert found.genicam == [] and found.outputs == [] and len(found.problems) == 2
    assert [text for text, heading in device_inventory.lines(found) if not heading].count("   none") >= 2


def test_serial_numbers_of_digits_are_quoted() -> None:
    assert [device_inventory._quoted(text) for text in ("A1", "40012345", "my cam", "0x1F")] == [
        "A1",
        '"40012345"',
        '"my cam"',
        '"0x1F"',
    ]


def test_an_unknown_area_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["doctor", "--only", "diks"]) == 2
    assert "disk" in capsys.readouterr().err
