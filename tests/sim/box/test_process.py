"""The rig in a box as a user starts it: it measures by itself and leaves nothing behind."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from fringed import subscribe
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from sim.box.box import Box, heads
from sim.box.options import from_mapping
from sim.box.xserver import XServer
from sim.devices.options import OptionError
from tools.waiting import wait_until

CONFIG = """
folder: {folder}
tcp: 0
exposure_us: 1000
drift_ppm: {{left: 30.0}}
simulation: {{scene: moving, frames: 3, rate_hz: 10.0, layout: {{scale: 0.125}}}}
"""


def clouds_measured(folder: Path) -> int:
    try:
        with ControlClient(f"ipc://{folder}/control", timeout_s=1.0) as client:
            return int(client.call("status")["clouds"])
    except ControlError:
        return 0


def mentioning(text: str) -> list[str]:
    """Command lines of the processes that mention a text."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            line = (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            environment = (process / "environ").read_bytes().decode(errors="replace")
        except OSError:
            continue
        if text in line or text in environment:
            found.append(line)
    return found


@pytest.mark.slow
@pytest.mark.usefixtures("make_box")
def test_a_box_measures_until_interrupted(tmp_path: Path) -> None:
    folder = tmp_path / "box"
    (tmp_path / "box.yaml").write_text(CONFIG.format(folder=folder))
    command = [sys.executable, "-m", "sim.box", "--config", str(tmp_path / "box.yaml")]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, start_new_session=True
    )
    try:
        wait_until(lambda: process.poll() is not None or clouds_measured(folder) > 5, 100, "clouds", poll_s=0.1)
        with closing(subscribe(f"ipc://{folder}/stream", timeout_s=30)) as clouds:
            assert len(next(clouds).points) > 5000
        # As a terminal does with Ctrl-C.
        os.killpg(process.pid, signal.SIGINT)
        output, _ = process.communicate(timeout=60)
    finally:
        process.kill()
        process.wait()
    assert process.returncode == 0, output
    assert "ready: 128 x 102 pixels, moving" in output and "everything is closed" in output
    assert "Traceback" not in output
    assert mentioning(str(folder)) == []
    assert not list((folder / "gentl").iterdir())


def test_a_mistake_gives_a_one_line_message(tmp_path: Path) -> None:
    file = tmp_path / "box.yaml"
    file.write_text("exposure: 3")
    command = [sys.executable, "-m", "sim.box", "--config", str(file)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr == f"sim.box: {file}: box.exposure is not an option; did you mean 'exposure_us'?\n"


@pytest.mark.usefixtures("make_box")
def test_a_box_in_front_of_an_x_server_that_runs_already(tmp_path: Path) -> None:
    given = {"folder": str(tmp_path / "box"), "tcp": 0, "simulation": {"scene": "plane", "layout": {"scale": 0.125}}}
    with XServer(heads(from_mapping(given))) as server, Box(from_mapping(given | {"display": server.display})) as box:
        assert box.server is None and box.display == server.display
        assert not box.world.step().dark
        server.kill()
        assert box.world.step().dark


@pytest.mark.parametrize("display", [7, "there:0", ":0; true"])
def test_an_invalid_display_is_rejected(display: object) -> None:
    with pytest.raises(OptionError, match=r"box\.display"):
        from_mapping({"display": display})
