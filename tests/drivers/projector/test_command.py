"""``fringed projector``: what the rig person types, without a daemon."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from daemon.cli import entry
from drivers.projector import images
from sim.box.xserver import XServer
from tests.drivers.projector import x
from tools.waiting import wait_until

FRINGED = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
Run = Callable[..., subprocess.CompletedProcess[str]]
RunHere = Callable[..., tuple[int, str, str]]


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-c", FRINGED, "projector", *arguments]


@pytest.fixture
def run(server: XServer) -> Run:
    def run(*arguments: str) -> subprocess.CompletedProcess[str]:
        environment = server.environment()
        return subprocess.run(
            command(*arguments), env=environment, capture_output=True, text=True, timeout=60, check=False
        )

    return run


@pytest.fixture
def run_here(server: XServer, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> RunHere:
    """As ``run``, in this process: exit status, output and errors."""
    monkeypatch.setenv("DISPLAY", server.display)

    def run(*arguments: str) -> tuple[int, str, str]:
        status = entry.run(["projector", *arguments])
        return status, *capsys.readouterr()

    return run


def test_list_has_a_line_for_each_output(run: Run, run_here: RunHere) -> None:
    done = run("list")
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "DUMMY0: 640x480 at +0+0, 60.000 Hz, native 640x480, gamma linear, primary",
        "DUMMY1: 320x256 at +640+0, 59.943 Hz, native 320x256, gamma linear",
    ]
    assert "DUMMY2: no connected device" in run_here("list", "--all")[1]


def test_the_test_image_stands_until_it_is_interrupted(server: XServer) -> None:
    held = subprocess.Popen(
        command("test", "--output", "DUMMY1"), env=server.environment(), stdout=subprocess.PIPE, text=True
    )
    wanted = images.alignment((320, 256))
    try:
        wait_until(lambda: np.array_equal(x.grab(server, 1), wanted), what="the image is on the output", poll_s=0.05)
        held.send_signal(signal.SIGINT)
        output, _ = held.communicate(timeout=30)
    finally:
        held.kill()
        held.wait()
    assert held.returncode == 0 and "320x256 pixels at 59.943 Hz" in output
    assert not x.grab(server, 1).any()


def test_a_png_of_the_right_size_is_shown_from_a_rig_file_that_is_not_complete(
    server: XServer, run: Run, tmp_path: Path
) -> None:
    image = x.noise(server, 1)
    cv2.imwrite(str(tmp_path / "image.png"), image[..., ::-1])
    rig = tmp_path / "rig.yaml"
    program = f"import sys; sys.path[:0] = {sys.path!r}; from tests.drivers.projector import x; import numpy as np"
    saved = "s = type('S', (), {'heads': (x.DESKTOP, x.PROJECTOR), 'display': sys.argv[1]})()"
    code = f"{program}; {saved}; np.save('seen.npy', x.grab(s, 1))"
    rig.write_text(
        "projector:\n  driver: pyglet\n  options:\n    output: DUMMY1\n"
        f"    hook: {{show: [[{sys.executable!r}, '-c', {code!r}, {server.display!r}]], timeout_s: 60.0}}\n"
    )
    done = run("show", str(tmp_path / "image.png"), "--rig", str(rig), "--seconds", "0.1")
    assert done.returncode == 0 and done.stderr == ""
    assert np.array_equal(np.load(tmp_path / "seen.npy"), image)


def test_images_that_are_not_exact_are_refused(run_here: RunHere, tmp_path: Path) -> None:
    small, deep, clear = (
        np.zeros((8, 8, 3), np.uint8),
        np.zeros((256, 320), np.uint16),
        np.zeros((256, 320, 4), np.uint8),
    )
    for name, image in (("small.png", small), ("deep.png", deep), ("clear.png", clear), ("lossy.jpg", small)):
        cv2.imwrite(str(tmp_path / name), image)
    for name, complaint in (
        ("small.png", "image (8, 8, 3) uint8 does not fit output DUMMY1, expected (256, 320, 3)"),
        ("deep.png", "uint16 (256, 320); expected 8 bits"),
        ("clear.png", "uint8 (256, 320, 4); expected 8 bits"),
        ("lossy.jpg", "expected an 8-bit PNG"),
        ("none.png", "none.png: No such file"),
    ):
        status, _, errors = run_here("show", str(tmp_path / name), "--output", "DUMMY1", "--seconds", "0.1")
        assert status == (1 if name == "small.png" else 2) and complaint in errors, errors


def test_wrong_usage_and_wrong_rigs_are_reported(run_here: RunHere, tmp_path: Path) -> None:
    assert run_here("show", "white")[0] == 2
    status, _, errors = run_here("test", "--output", "HDMI-9")
    assert status == 1 and "there are: DUMMY0, DUMMY1" in errors
    rig = tmp_path / "rig.yaml"
    for text, complaint in (
        ("projector: {driver: pyglet, options: {output: a, outptu: b}}", "projector.outptu: no such option"),
        ("projector: {driver: sim}", "which cannot show images"),
        ("cameras: {driver: sim}", "no section projector"),
        ("projector: [", "YAML syntax"),
    ):
        rig.write_text(text)
        status, _, errors = run_here("off", "--rig", str(rig))
        assert status == 2 and complaint in errors and "Traceback" not in errors


def test_off_runs_the_commands_of_an_external_projector(run: Run, tmp_path: Path) -> None:
    rig, touch = tmp_path / "rig.yaml", "import sys; open(sys.argv[1], 'w').close()"
    hook = {key: [[sys.executable, "-c", touch, key]] for key in ("open", "show", "close")}
    rig.write_text(f"projector: {{driver: external, options: {{size: [8, 8], hook: {hook!r}}}}}")
    assert run("off", "--rig", str(rig)).returncode == 0
    assert {"open", "close"} == set(os.listdir(tmp_path)) - {"rig.yaml"}  # noqa: PTH208


@pytest.mark.parametrize("size", [(320, 256), (321, 257), (1280, 800), (912, 1140)])
def test_the_alignment_image_shows_each_edge_and_each_level(size: tuple[int, int]) -> None:
    image = images.alignment(size)
    width, height = size
    assert image.shape == (height, width, 3) and image.dtype == np.uint8
    assert all((edge == 255).all() for edge in (image[0], image[-1], image[:, 0], image[:, -1]))
    border = image[1:15, 1:-1, 0].astype(int)
    middle = np.abs(np.diff(border, axis=1)) == 255
    assert middle.mean() > 0.95, "neighbours differ by everything: any scaling shows"
    grey = image[(image == image[..., :1]).all(axis=2)][:, 0]
    assert len(set(grey.tolist())) >= 250, "nearly every level, even where the cross hairs take a few"
    for color in images.COLORS:
        assert (image == color).all(axis=2).any()
