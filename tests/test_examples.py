"""Every example runs as a user starts it: on a daemon of examples/rig.yaml, small, or on the committed take."""

from __future__ import annotations

import ast
import re
import runpy
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
import yaml

import fringed
from tests.daemon.whole_daemon import measuring
from tests.golden.make import TAKE

EXAMPLES = Path(__file__).parents[1] / "examples"
PROGRAMS = sorted(EXAMPLES.glob("*.py"))
CLOUD = r"cloud (\d+): (\d+) points, median depth (\d+\.\d\d) mm, lost so far \d+"


@pytest.fixture(scope="module")
def address(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """Control of a daemon that measures with examples/rig.yaml, with a sixteenth of the pixels each way."""
    folder = tmp_path_factory.mktemp("rig")
    rig = yaml.safe_load((EXAMPLES / "rig.yaml").read_text())
    rig["simulation"] |= {"frames": 2, "rate_hz": 10.0, "layout": {"scale": 0.0625}, "cache_dir": "cache"}
    rig["stream"]["endpoints"] = [f"ipc://{folder}/s"]
    rig["control"] = {"endpoint": f"ipc://{folder}/c"}
    rig["recording"]["min_free_mb"] = 1
    with measuring(folder, re.sub(r"([{}])", r"\1\1", yaml.safe_dump(rig))) as control:
        yield control


def run(name: str, *arguments: str) -> list[str]:
    """The lines that an example prints."""
    command = [sys.executable, "-W", "error", str(EXAMPLES / name), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.splitlines()


@pytest.fixture
def run_here(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Callable[..., list[str]]:
    """As ``run``, in this process, which has loaded the kernels; for examples that another test starts."""

    def run(name: str, *arguments: str) -> list[str]:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        runpy.run_path(str(EXAMPLES / name), run_name="__main__")
        return capsys.readouterr().out.splitlines()

    return run


def points(line: str) -> int:
    return int(line.partition(": ")[2].split()[0])


def test_the_clouds_of_a_running_daemon_are_printed(address: str) -> None:
    found = [re.fullmatch(CLOUD, line) for line in run("01_clouds.py", address, "3")]
    assert len(found) == 3
    assert all(line and int(line[2]) > 500 and 1200 < float(line[3]) < 1600 for line in found)


def test_the_plain_reader_prints_the_same_stream(address: str) -> None:
    with fringed.Rig(address) as rig:
        lines = run("02_plain_reader.py", rig.stream, "2")
    assert [line.split()[0] for line in lines] == ["cloud/full"] * 2


def test_a_rig_is_operated_and_left_as_it_was(address: str) -> None:
    state, take, snapshot = run("04_operate_a_rig.py", address)
    assert state.startswith("rig-01: running, ") and re.search(r"example_\w+\.npz: \d+ points$", snapshot)
    with fringed.Rig(address) as rig:
        assert rig.get("recording.sync") == "1s"
        assert take.endswith(f": {rig.takes().takes[-1].frames[0]} pairs")


def test_the_clouds_of_a_take_are_printed(run_here: Callable[..., list[str]]) -> None:
    lines = run_here("01_clouds.py", str(TAKE))
    assert [re.fullmatch(CLOUD, line)[1] for line in lines] == ["0", "1"]  # type: ignore[index]


def test_a_take_is_read_with_another_setting(run_here: Callable[..., list[str]]) -> None:
    head, *pairs = run_here("03_read_a_take.py", str(TAKE))
    assert ", session " in head and len(pairs) == 2
    _, changed, *fewer = run("03_read_a_take.py", str(TAKE), "pipeline.settings.min_modulation", "60.0")
    assert changed == "pipeline.settings.min_modulation = 60.0"
    assert all(0 < points(after) < points(before) for before, after in zip(pairs, fewer, strict=True))


@pytest.mark.parametrize("path", PROGRAMS, ids=lambda path: path.name)
def test_an_example_begins_with_its_command_line_and_imports_public_names_only(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    assert f"python {'' if 'plain' in path.name else 'examples/'}{path.name}" in (ast.get_docstring(tree) or "")
    imported = {alias.name for node in ast.walk(tree) if isinstance(node, ast.Import) for alias in node.names}
    imported |= {node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    assert imported - {"numpy", "zmq"} - sys.stdlib_module_names <= {"fringed"}
    attributes = [node for node in ast.walk(tree) if isinstance(node, ast.Attribute)]
    assert {node.attr for node in attributes if ast.unparse(node.value) == "fringed"} <= set(fringed.__all__)
