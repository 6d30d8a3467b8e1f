"""Each kind of bad input is rejected with its own message that names the images, and no file is changed."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.cli.entry import run
from tests.daemon.apps.calibration import drawn
from tests.daemon.apps.calibration.conftest import BOARD

Change = Callable[[np.ndarray], np.ndarray]
OLD = b"fringed_calibration: 1\n# a calibration that must stay as it is\n"


@pytest.fixture
def images(images: Path) -> Path:
    """Four views of the session: as many as the reasons below need."""
    for path in images.glob("[LR]/0[4-9].png"):
        path.unlink()
    return images


def every(folder: Path, how: Change, *, sides: str = "LR") -> None:
    for side in sides:
        for path in sorted((folder / side).iterdir()):
            image = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
            drawn.write_png(path, np.ascontiguousarray(how(image)))


def one(folder: Path, name: str, how: Change) -> None:
    image = cv2.imread(str(folder / name), cv2.IMREAD_UNCHANGED)
    drawn.write_png(folder / name, np.ascontiguousarray(how(image)))


def identical(folder: Path) -> None:
    for side in "LR":
        first = (folder / side / "00.png").read_bytes()
        for path in (folder / side).iterdir():
            path.write_bytes(first)


def shifted(folder: Path) -> None:
    """Shift the right images by one view."""
    paths = sorted((folder / "R").iterdir())
    data = [path.read_bytes() for path in paths]
    for path, moved in zip(paths, data[1:] + data[:1], strict=True):
        path.write_bytes(moved)


CASES: dict[str, tuple[Callable[[Path], object], str]] = {
    "blurred": (
        lambda f: every(f, lambda p: cv2.GaussianBlur(p, (0, 0), 5)),
        r"L/00.png: image too blurred",
    ),
    "very blurred": (
        lambda f: every(f, lambda p: cv2.GaussianBlur(p, (0, 0), 9)),
        r"L/00.png: image too blurred",
    ),
    "empty": (
        lambda f: every(f, lambda p: np.full_like(p, 90)),
        r"L/00.png: no marks found: the board circles:9x7:24:14 is not in the image",
    ),
    "right camera mirrored": (
        lambda f: every(f, lambda p: p[:, ::-1], sides="R"),
        r"R/\*.png: the images of (left|right) are mirrored",
    ),
    "both mirrored": (
        lambda f: every(f, lambda p: p[:, ::-1]),
        r"L/\*.png.*: .*left and right are swapped, or both cameras' images are mirrored",
    ),
    "two boards": (
        lambda f: every(f, lambda p: np.hstack([p, p])),
        r"L/00.png: the image shows two boards",
    ),
    "identical views": (identical, r"the 4 views are all alike"),
    "shifted views": (shifted, r"contradict each other: only .* views agree"),
    "counts differ": (
        lambda f: (f / "R" / "03.png").unlink(),
        r"--left .*L/\*.png names 4 images and --right .*R/\*.png names 3",
    ),
    "sizes differ": (
        lambda f: one(f, "R/03.png", lambda p: p[:-20]),
        r"R/03.png: 400 x 300 pixels, but .*R/00.png has 400 x 320",
    ),
    "truncated": (
        lambda f: (f / "L/02.png").write_bytes((f / "L/02.png").read_bytes()[:2000]),
        r"L/02.png: the image is damaged or truncated",
    ),
    "empty file": (lambda f: (f / "L/02.png").write_bytes(b""), r"L/02.png: the file is empty"),
    "no image": (
        lambda f: (f / "R/03.png").write_text("a text"),
        r"R/03.png: not a readable image; expected a PNG, JPEG, TIFF or BMP",
    ),
    "too small": (
        lambda f: one(f, "L/00.png", lambda p: p[:40, :40]),
        r"L/00.png: 40 x 40 pixels; expected 64 to 16384",
    ),
    "too few views": (
        lambda f: [path.unlink() for path in f.glob("[LR]/0[2-3].png")],
        r"2 views of the board, at least 3 are required",
    ),
}


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


def rejected(folder: Path, capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """Run a command that must fail without changing any file; return its message."""
    (folder / "calibration.yaml").write_bytes(OLD)
    before = snapshot(folder)
    assert run(["calibrate", *arguments, "--out", str(folder / "new.yaml"), "--report", str(folder / "r.html")]) in (
        1,
        2,
    )
    assert snapshot(folder) == before
    lines = [line for line in capsys.readouterr().err.splitlines() if line.startswith("fringed: ")]
    assert len(lines) == 1
    return lines[0]


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=pytest.mark.long) if case == "very blurred" else case for case in CASES]
)
def test_bad_images_are_rejected(images: Path, capsys: pytest.CaptureFixture[str], case: str) -> None:
    spoil, expected = CASES[case]
    spoil(images)
    left, right = str(images / "L" / "*.png"), str(images / "R" / "*.png")
    message = rejected(images, capsys, "cameras", "--left", left, "--right", right, "--board", BOARD)
    assert re.search(expected, message), message


def test_swapped_cameras_are_rejected(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = str(images / "L" / "*.png"), str(images / "R" / "*.png")
    message = rejected(images, capsys, "cameras", "--left", right, "--right", left, "--board", BOARD)
    assert "left and right are swapped" in message


def test_the_wrong_board_is_rejected(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = str(images / "L" / "*.png"), str(images / "R" / "*.png")
    message = rejected(images, capsys, "cameras", "--left", left, "--right", right, "--board", "circles:8x6:24")
    assert "L/00.png: wrong board: the image shows a grid of 9x7 marks, but 8x6 is expected" in message


def test_images_of_one_camera_for_both_are_rejected(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = str(images / "L" / "*.png")
    message = rejected(images, capsys, "cameras", "--left", left, "--right", left, "--board", BOARD)
    assert "named by both --left and --right" in message


def test_a_pattern_without_files_is_rejected(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left = str(images / "nothing" / "*.png")
    message = rejected(images, capsys, "cameras", "--left", left, "--right", left, "--board", BOARD)
    assert "no file matches" in message


def test_a_projector_without_fringes_is_rejected(images: Path, capsys: pytest.CaptureFixture[str]) -> None:
    left, right = str(images / "L" / "*.png"), str(images / "R" / "*.png")
    message = rejected(images, capsys, "projector", "--left", left, "--right", right, "--board", BOARD)
    assert "no sequence with fringes in both directions" in message


def test_some_bad_images_are_left_out_and_named(
    images: Path, session_folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for side in "LR":
        shutil.copy(session_folder / side / "04.png", images / side)
    one(images, "L/01.png", lambda p: cv2.GaussianBlur(p, (0, 0), 5))
    one(images, "R/04.png", lambda p: np.full_like(p, 90))
    left, right = str(images / "L" / "*.png"), str(images / "R" / "*.png")
    out = str(images / "new.yaml")
    assert run(["calibrate", "cameras", "--left", left, "--right", right, "--board", BOARD, "--out", out]) == 0
    output = capsys.readouterr()
    assert re.search(r"left out: .*L/01.png: image too blurred", output.err)
    assert re.search(r"left out: .*R/04.png: no marks found", output.err)
    page = (images / "new.report.html").read_text()
    assert "image too blurred" in page
