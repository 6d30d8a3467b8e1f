"""The measuring process carries no viewer, no plotting and no simulator, unless rig.yaml names it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

_PROGRAM = """
import sys, threading, types
from pathlib import Path
from daemon.bootstrap import run
from daemon.live import service
from daemon.config import driver_table
from tests.daemon.bootstrap import silent_rig
driver_table.RIGS["silent"] = "tests.daemon.bootstrap.silent_rig:open_rig"
path = Path(sys.argv[1])
silent_rig.write(path)
flag = run.StopFlag()
states = []
def on_status(status):
    states.append(status["state"])
    if status["state"] == "running":
        flag.request()
run.run_rig(path / "rig.yaml", flag=flag, on_status=on_status)
heavy = ("rerun", "matplotlib", "sim", "pyarrow", "trimesh")
solving = ("daemon.apps.calibration", *(f"pipeline.calibrate.{part}" for part in ("bundle", "targets", "color")))
loaded = [name for name in sys.modules if name.partition(".")[0] in heavy or name.startswith(solving)]
print(states[-1], sorted(loaded))
"""


def test_a_running_daemon_has_not_imported_what_it_does_not_need(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", _PROGRAM, str(tmp_path)], capture_output=True, text=True, timeout=100, check=False
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.split(maxsplit=1) == ["stopping", "[]\n"], done.stdout + done.stderr
