"""Every block of the documentation is run, or parsed by the program's own parser, or has a stated reason.

Blocks marked ``run`` and all Python blocks of a page are run in their order, in one directory, beside a daemon of a
small simulated rig. All other shell lines are checked by the parser of the commands, the Makefile and the list of
programs.
"""

from __future__ import annotations

import gc
import json
import os
import shutil
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
import yaml

from daemon.cli import entry
from daemon.common.errors import ConfigError
from daemon.config.load import parse_rig
from daemon.rig.pose_file import read_pose
from fringed.control.client import ControlClient
from tools.docs import command_lines
from tools.docs.pages import ROOT, Block, blocks, pages
from tools.waiting import wait_until

BLOCKS = [block for page in pages() for block in blocks(page)]
RUN = "<!-- run -->"
RIG = """cameras: {{driver: sim}}
simulation: {{scene: spheres, frames: 2, rate_hz: 4.0, layout: {{scale: 0.125}}}}
stream: {{endpoints: ["ipc://{folder}/stream"]}}
recording: {{dir: takes, min_free_mb: 10}}
"""
STREAM = "tcp://127.0.0.1:5555"
RIG_KEYS = {"cameras", "projector", "simulation", "pipeline", "stream", "control", "recording", "health", "selfcheck",
            "security", "mode", "sequence", "calibration", "pairing", "outputs", "preset"}  # fmt: skip
HEALTH = {0, 1, 4}
"""Exit statuses of ``fringed health`` with a daemon: its verdict on a busy machine is not the subject here."""
OTHER_YAML = {
    "jobqueue": "dask-jobqueue", "apiVersion": "Kubernetes", "drift_ppm": "the emulated box",
}  # fmt: skip


def of(*languages: str) -> list[Block]:
    return [block for block in BLOCKS if block.language in languages]


def running(block: Block) -> bool:
    return block.comment == RUN or (block.language == "python" and not block.reason)


@pytest.mark.parametrize("block", [b for b in of("sh") if b.comment != RUN], ids=lambda b: b.name)
def test_every_shell_line_is_accepted_by_its_program(block: Block) -> None:
    assert command_lines.check(block.text) == []


def test_a_wrong_shell_line_is_reported() -> None:
    wrong = "fringed staus\nfringed get --nope\nsudo fringed calibrate board  # a comment\nmake nothing | rm -r x\n"
    assert [line.partition(": ")[2] for line in command_lines.check(wrong)] == [
        "there is no such command",
        "No such option: --nope",
        "fringed calibrate board needs pdf",
        "no such target of the Makefile",
        "rm is not in tools.docs.command_lines.PROGRAMS",
    ]
    right = "for x in a b; do ssh $x fringed worker tcp://head:8786 & done\nfringed status \\\n  --once\n"
    assert command_lines.check(right) == []


@pytest.mark.parametrize("block", of("yaml"), ids=lambda b: b.name)
def test_every_yaml_block_is_accepted_by_its_reader(block: Block, tmp_path: Path) -> None:
    data = yaml.safe_load(block.text)
    if "fringed_pose" in data:
        (tmp_path / "pose.yaml").write_text(block.text)
        assert read_pose(tmp_path / "pose.yaml").frame == data["frame"]
        return
    if block.reason or set(data) & set(OTHER_YAML):
        return
    assert set(data) & RIG_KEYS, f"of which file are {list(data)}?"
    if "cameras" not in data:
        data |= {"cameras": {"driver": "sim"}}
    elif data["cameras"]["driver"] != "sim":
        data.setdefault("projector", {"driver": "external"})
    try:
        parse_rig(yaml.safe_dump(data), base_dir=ROOT, complete=False)
    except ConfigError as error:
        missing = ("does not exist", "No such file", "there is no file")
        assert all(any(text in problem for text in missing) for problem in error.problems), error


@pytest.mark.parametrize("block", of("json"), ids=lambda b: b.name)
def test_every_json_block_is_json(block: Block) -> None:
    json.loads(block.text)


def test_every_block_has_a_known_language_and_python_compiles() -> None:
    known = {"sh", "python", "yaml", "json", "text"}
    assert [block.name for block in BLOCKS if block.language not in known] == []
    for block in of("python"):
        compile(block.text, block.name, "exec")


class Enough(Exception):
    """Ends an endless loop of a block after some lines of output."""


@pytest.fixture(scope="module")
def live(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A directory with a take and a calibration, in which a daemon measures; commands find it without options."""
    folder = tmp_path_factory.mktemp("d")
    shutil.copy(ROOT / "tests" / "golden" / "take.mcap", folder)
    (folder / "rig.yaml").write_text(RIG.format(folder=folder))
    environment = os.environ | {"XDG_RUNTIME_DIR": str(folder)}
    environment.pop("RUNTIME_DIRECTORY", None)
    command = [sys.executable, "-c", "from daemon.cli.entry import main; main()", "run", "rig.yaml"]
    process = subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.DEVNULL)
    try:
        with ControlClient(f"ipc://{folder}/fringed/control", timeout_s=1.0) as client:
            wait_until(lambda: process.poll() is not None or state(client) == "running", 100, poll_s=0.05)
        yield folder
    finally:
        process.terminate()
        process.wait(100)  # compiling, which a page may cause, ends with the function in work


def state(client: ControlClient) -> Any:
    from fringed.errors import ControlError

    try:
        return client.call("status")["state"]
    except ControlError:
        return None


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted({b.page for b in BLOCKS if running(b)}), ids=lambda p: str(p.relative_to(ROOT)))
def test_the_blocks_of_the_page_run(page: Path, live: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(live)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(live))
    monkeypatch.delenv("RUNTIME_DIRECTORY", raising=False)
    for block in blocks(page):
        if block.language == "sh" and block.comment == RUN:
            for arguments in command_lines.fringed_lines(block.text):
                run(arguments, live, block)
        elif block.language == "python" and not block.reason:
            execute(block, live)


def run(arguments: list[str], live: Path, block: Block) -> None:
    """Run a command in this process; a listener gets the daemon's address in place of the usual one."""
    if arguments[0] in ("listen", "view"):
        arguments = [arguments[0], f"ipc://{live}/stream", *arguments[1:]]
    accepted = HEALTH if arguments[0] == "health" else {0}
    assert entry.run(arguments) in accepted, f"{block.name}: fringed {' '.join(arguments)}"


def execute(block: Block, live: Path) -> None:
    """Run a Python block, up to its third line of output."""
    lines: list[str] = []

    def print_some(*values: object, **_: object) -> None:
        lines.append(" ".join(map(str, values)))
        if len(lines) == 3:
            raise Enough

    code = compile(block.text.replace(STREAM, f"ipc://{live}/stream"), block.name, "exec")
    names: dict[str, Any] = {"__name__": "__main__", "print": print_some}
    with warnings.catch_warnings(action="ignore", category=ResourceWarning), suppress(Enough):
        exec(code, names)
    with warnings.catch_warnings(action="ignore", category=ResourceWarning):
        names.clear()  # the interrupted loop leaves its sockets open
        gc.collect()
    assert lines and all(lines), f"{block.name} printed nothing"
