"""What a person mistypes: one sentence, exit status 2, no traceback, no path that is not theirs, within a second."""

from __future__ import annotations

import os
import subprocess
import sys
import time
import warnings
from pathlib import Path

import pytest

from daemon.cli import entry
from tests.golden.make import TAKE

RIG = """\
device: {name: rig-x}
cameras: {driver: sim}
simulation: {scene: moving, frames: 2, layout: {scale: 0.25}}
"""
BAD_RIG = "cameras: {driver: sim}\nsimulation: {scene: nosuch, frames: -3, rate_hz: .inf, layout: {scale: 1000}}\n"
NO_DAEMON = ("no daemon answers at ", "there is no such socket", "fringed run rig.yaml")

CASES: dict[str, tuple[str, ...]] = {
    "replay": ("missing argument 'take'", "fringed replay -h"),
    "replay nope.mcap --out o": ("nope.mcap: ",),
    "replay take.mcap": ("--out DIR",),
    "replay take.mcap --out rig.yaml": ("rig.yaml is a file; name a directory",),
    "replay take.mcap --out o --format xyz": ("'xyz', expected one of: npz, ply, pcd",),
    "replay take.mcap --out o --set smoothing=nan": ("expected key=value",),
    "replay take.mcap --no-output --expect nope.json": ("nope.json: ",),
    "run": ("missing argument 'rig'",),
    "run nope.yaml": ("'nope.yaml' does not exist",),
    "run rig.yaml --record ../../x": ("the name '../../x'",),
    "record rig.yaml --name ../../x": ("the name '../../x'",),
    "record --name ../../x rig.yaml": ("the name '../../x'",),
    "record start --name ../../x": ("the name '../../x'",),
    "snapshot --name ../../x": ("the name '../../x'",),
    "demo --scene nosuch": ("--scene is 'nosuch', expected one of plane",),
    "demo --scene nosuch --no-view": ("--scene is 'nosuch', expected one of plane",),
    "demo --mesh nope.ply --no-view": ("nope.ply",),
    "demo --mesh rig.yaml --no-view --frames 1 --small": ("rig.yaml cannot be read",),
    "view": ("there is no screen", "--web", "--save FILE.rrd"),
    "view foo --web": ("'foo'", "tcp://HOST:PORT"),
    "set pairing.tolerance_us nan": ("nan is not a finite number",),
    "set pairing.tolerance_us -Infinity": ("-Infinity is not a finite number",),
    "export nope --out o": ("nope: no such file or directory",),
    "export cloud.ply --out o": ("exported cloud already",),
    "export empty --out o": ("there are no clouds",),
    "export several --out video.mp4": ("a.mcap, b.mcap; a video shows one of them",),
    "status --endpoint foo": ("no daemon answers at foo", "ipc://PATH"),
    "status --endpoint tcp://127.0.0.1:1": ("no daemon answers at tcp://127.0.0.1:1: nothing listens there",),
    "takes lst": ("did you mean 'list'",),
}
FOR_A_DAEMON = (
    "status", "get", "set pairing.tolerance_us 5", "mode", "mode gray", "record start", "record stop", "snapshot",
    "reload", "start", "stop", "pattern white",
)  # fmt: skip
CASES |= dict.fromkeys(FOR_A_DAEMON, NO_DAEMON)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("typed")
    (made / "rig.yaml").write_text(RIG)
    (made / "bad.yaml").write_text(BAD_RIG)
    (made / "cloud.ply").write_text("ply\n")
    (made / "empty").mkdir()
    (made / "several").mkdir()
    for name in ("take.mcap", "several/a.mcap", "several/b.mcap"):
        (made / name).symlink_to(TAKE)
    return made


def fringed(folder: Path, *arguments: str) -> tuple[int, str, float]:
    code = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
    environment = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}
    environment |= {"XDG_RUNTIME_DIR": str(folder / "run"), "PYTHONPATH": os.pathsep.join(sys.path)}
    start_s = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, timeout=60, check=False,
        cwd=folder, env=environment,
    )  # fmt: skip
    return done.returncode, done.stderr, time.monotonic() - start_s


@pytest.fixture
def at_the_prompt(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The directory and the environment of :func:`fringed` for commands that run in the tests' process."""
    monkeypatch.chdir(folder)
    monkeypatch.setattr("warnings.showwarning", warnings.showwarning)  # a command replaces it
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(folder / "run"))
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def expect_one_sentence(line: str, status: int, answer: str) -> None:
    answer = "".join(row for row in answer.splitlines(keepends=True) if not row.startswith("Rendering"))
    assert status == 2 and answer.count("\n") == 1 and answer.startswith("fringed: "), answer
    assert "Traceback" not in answer and ".py" not in answer and "demo-" not in answer and "[Errno" not in answer
    assert all(part in answer for part in CASES[line]), answer


@pytest.mark.usefixtures("at_the_prompt")
@pytest.mark.parametrize("line", CASES)
def test_a_wrong_input_is_answered_by_one_sentence_and_status_2(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    expect_one_sentence(line, entry.run(line.split()), capsys.readouterr().err)


@pytest.mark.usefixtures("at_the_prompt")
def test_a_rig_file_is_answered_by_one_line_for_each_mistake(capsys: pytest.CaptureFixture[str]) -> None:
    assert entry.run(["run", "bad.yaml"]) == 2
    answer = capsys.readouterr().err
    positions = [row.removeprefix("fringed: ").split(": ")[0] for row in answer.splitlines()]
    assert positions == ["bad.yaml:2:21", "bad.yaml:2:37", "bad.yaml:2:50", "bad.yaml:2:72"], answer


@pytest.mark.alone
@pytest.mark.parametrize(
    "line",
    [
        pytest.param("mode", marks=pytest.mark.long),
        "record stop",
        "replay",
        "run nope.yaml",
        "demo --scene nosuch",
        "view",
    ],
)
def test_a_process_answers_within_a_second_and_a_half(line: str, folder: Path) -> None:
    """The limit is one second on an idle machine: the rest is for a busy one."""

    def elapsed_s() -> float:
        status, answer, elapsed = fringed(folder, *line.split())
        expect_one_sentence(line, status, answer)
        return elapsed

    assert any(elapsed_s() < 1.5 for _ in range(3))
