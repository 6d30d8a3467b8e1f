"""A rig of cameras of one driver and a projector of another."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from daemon.bootstrap.run import run_rig
from daemon.cli.setup.check import check_file
from daemon.common.errors import ConfigError
from daemon.config import driver_table, load_rig
from daemon.rig.open_rig import open_rig
from tests.daemon.bootstrap import silent_rig

THIS = "tests.daemon.rig.test_open_rig"
opened: list[Any] = []


def open_camera(side: str, options: dict[str, Any], base_dir: Path) -> silent_rig.Camera:
    if options.get("gain", 0) > 10:
        raise ValueError(f"cameras.{side}.gain is {options['gain']}, limit 10")
    opened.append((side, options, base_dir))
    return silent_rig.Camera(side)


def open_projector(options: dict[str, Any], base_dir: Path) -> silent_rig.Projector:
    if "output" not in options:
        raise ValueError("projector.output is missing, there are: HDMI-1")
    opened.append(("projector", options, base_dir))
    return silent_rig.Projector()


@pytest.fixture
def rig_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setitem(driver_table.CAMERAS, "test", f"{THIS}:open_camera")
    monkeypatch.setitem(driver_table.PROJECTORS, "test", f"{THIS}:open_projector")
    silent_rig.write(tmp_path)
    opened.clear()
    return tmp_path / "rig.yaml"


def rewrite(path: Path, cameras: str, projector: str) -> None:
    lines = [line for line in path.read_text().splitlines() if not line.startswith(("cameras", "projector"))]
    path.write_text("\n".join([f"cameras: {cameras}", f"projector: {projector}", *lines]))


def test_each_device_gets_its_own_options(rig_file: Path) -> None:
    rewrite(rig_file, "{driver: test, left: {gain: 1}, right: {gain: 2}}", "{driver: test, options: {output: HDMI-1}}")
    rig = open_rig(load_rig(rig_file), rig_file.parent)
    expected = [("left", {"gain": 1}), ("right", {"gain": 2}), ("projector", {"output": "HDMI-1"})]
    assert opened == [(name, options, rig_file.parent) for name, options in expected]
    assert set(rig.cameras) == {"left", "right"}
    rig.release()


@pytest.mark.parametrize(
    ("cameras", "projector", "place", "message"),
    [
        ("{driver: test, right: {gain: 11}}", "{driver: test, options: {output: A}}", ":1:33", "gain is 11, limit 10"),
        ("{driver: test}", "{driver: test, options: {}}", ":2:", "projector.options.output is missing"),
        ("{driver: test}", "null", ":1:1", "projector is missing; the cameras 'test' need one of: "),
        ("{driver: test}", "{driver: sim}", ":1:1", "projector.driver is 'sim'; the cameras 'test' need one of: "),
        ("{driver: tset}", "{driver: test}", ":1:", "there is no driver 'tset'; did you mean 'test'?"),
    ],
)
def test_errors_are_reported_with_their_line(
    rig_file: Path, cameras: str, projector: str, place: str, message: str
) -> None:
    rewrite(rig_file, cameras, projector)
    with pytest.raises(ConfigError) as error:
        run_rig(rig_file)
    (problem,) = error.value.problems
    assert message in problem
    assert problem.startswith(f"{rig_file}{place}")


def test_check_validates_the_drivers_options_without_touching_a_device(rig_file: Path) -> None:
    rewrite(rig_file, "{driver: test, right: {gain: 11}}", "{driver: test, options: {output: A}}")
    good, lines = check_file(rig_file)
    assert not good
    assert lines == [f"{rig_file}:1:33: cameras.right.gain is 11, limit 10"]
    rewrite(rig_file, "{driver: test, right: {gain: 1}}", "{driver: test, options: {output: A}}")
    assert check_file(rig_file)[0]


def test_check_reports_an_error_in_the_simulations_options(tmp_path: Path) -> None:
    path = tmp_path / "rig.yaml"
    path.write_text("cameras: {driver: sim}\nsimulation: {scene: plnae}\n")
    good, (line,) = check_file(path)
    assert not good and line.startswith(f"{path}:2:") and "plnae" in line
