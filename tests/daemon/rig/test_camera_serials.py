"""Serial numbers travel from the cameras through images and takes into calibrations, and contradictions are errors."""

from __future__ import annotations

from pathlib import Path

import pytest

from daemon.apps.calibration.solve.archive import store
from daemon.apps.replay.runner import Replay
from daemon.common.errors import InputError
from daemon.recording.read.take_reader import TakeReader
from daemon.rig.calibration_file import read_calibration, write_calibration
from daemon.rig.camera_serials import common_serials, serial_problem, serials_in, serials_of_take, take_metadata
from pipeline.common.errors import CalibrationError

GOLDEN = Path(__file__).parents[2] / "golden" / "take.mcap"
A1_B2 = {"left": "A1", "right": "B2"}


def test_known_numbers_are_compared_and_exchanged_cameras_are_named():
    assert serial_problem(A1_B2, A1_B2) == ""
    assert serial_problem({}, A1_B2) == serial_problem(A1_B2, {}) == ""
    assert serial_problem(A1_B2, {"left": "", "right": "B2"}) == ""
    assert "exchanged: left is B2 and right is A1" in serial_problem(A1_B2, {"left": "B2", "right": "A1"})
    assert serial_problem(A1_B2, {"left": "A1", "right": "C3"}).startswith("camera right is C3, calibrated was B2")


@pytest.mark.parametrize("serials", [{}, {"left": "A1"}, A1_B2])
def test_a_take_returns_what_was_written(serials: dict):
    assert serials_of_take(take_metadata(serials)) == serials


def test_sources_of_one_calibration_agree():
    assert common_serials([("views", {}), ("a.mcap", {"left": "A1"}), ("b.mcap", A1_B2)]) == A1_B2
    with pytest.raises(InputError, match=r"b.mcap: its left images are of camera B2, those of a.mcap are of camera A1"):
        common_serials([("a.mcap", A1_B2), ("b.mcap", {"left": "B2", "right": "A1"})])


def test_a_new_calibration_has_the_numbers_of_its_images_and_else_keeps_those_of_the_old_file(tmp_path: Path):
    with TakeReader(GOLDEN) as take:
        calibration = take.calibration().calibration
    path = tmp_path / "calibration.yaml"
    for serials, expected in ((A1_B2, A1_B2), (None, A1_B2), ({"right": "C3"}, {"left": "A1", "right": "C3"})):
        store(path, calibration, quality={}, serials=serials)
        assert serials_in(read_calibration(path).mapping["cameras"]) == expected


def test_a_recording_of_other_cameras_is_not_reconstructed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = tmp_path / "calibration.yaml"
    with TakeReader(GOLDEN) as take:
        cameras = {side: {"serial": serial} for side, serial in A1_B2.items()}
        write_calibration(path, take.calibration().calibration, keep={"cameras": cameras})
        replay = Replay(take, calibration=path)
        monkeypatch.setitem(take.metadata, "serial_left", "A1")
        assert serials_in(replay.calibration_file.mapping["cameras"]) == A1_B2
        monkeypatch.setitem(take.metadata, "serial_left", "B2")
        monkeypatch.setitem(take.metadata, "serial_right", "A1")
        with pytest.raises(
            CalibrationError, match=r"take.mcap: the recording is not of the calibrated cameras: .*exch"
        ):
            _ = Replay(take, calibration=path).calibration_file
