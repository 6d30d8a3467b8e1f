"""One drawn session for all tests of the commands."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.rig.calibration_file import write_calibration
from pipeline.calibrate.targets.board.board import Board, parse_board
from pipeline.pattern.sequence import projector_sequence
from pipeline.rig.calibration import Cameras
from tests.daemon.apps.calibration import drawn

BOARD = "circles:9x7:24:14"


@pytest.fixture(scope="session", autouse=True)
def _one_thread() -> Iterator[None]:
    """OpenCV's threads gain nothing on images of this size."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(before)


@pytest.fixture(scope="session")
def board() -> Board:
    return parse_board(BOARD)


@pytest.fixture(scope="session")
def true_rig() -> Cameras:
    return drawn.rig()


@pytest.fixture(scope="session")
def session_folder(tmp_path_factory: pytest.TempPathFactory, board: Board, true_rig: Cameras) -> Path:
    """``L/00.png`` ..., ``R/00.png`` ...: ten poses of the board."""
    folder = tmp_path_factory.mktemp("session")
    drawn.write_pairs(folder, true_rig, board, drawn.poses(board, 10))
    return folder


@pytest.fixture
def images(tmp_path: Path, session_folder: Path) -> Path:
    """A copy of the session that may be changed."""
    for side in ("L", "R"):
        shutil.copytree(session_folder / side, tmp_path / side)
    return tmp_path


@pytest.fixture(scope="session")
def capture_folder(tmp_path_factory: pytest.TempPathFactory, board: Board, true_rig: Cameras) -> Path:
    """A capture folder with fringes, four poses of the board."""
    folder = tmp_path_factory.mktemp("capture") / "fringes"
    sequence = projector_sequence(drawn.PROJECTOR, steps=4)
    drawn.write_capture(folder, true_rig, board, drawn.poses(board, 4, seed=1), sequence, seed=1)
    return folder


@pytest.fixture(scope="session")
def truth_file(tmp_path_factory: pytest.TempPathFactory, true_rig: Cameras) -> Path:
    path = tmp_path_factory.mktemp("truth") / "calibration.yaml"
    write_calibration(path, true_rig.complete())
    return path


@pytest.fixture
def spoil() -> Callable[[Path, Callable[[np.ndarray], np.ndarray]], None]:
    """A function that changes the image in a file."""

    def change(path: Path, how: Callable[[np.ndarray], np.ndarray]) -> None:
        image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert image is not None
        drawn.write_png(path, np.ascontiguousarray(how(image)))

    return change
