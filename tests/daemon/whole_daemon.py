"""A whole daemon on the simulated rig, in a thread of the tests' process: clouds, control, recorder, health."""

from __future__ import annotations

import logging
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from daemon.bootstrap import run
from fringed.control.client import ControlClient
from fringed.errors import ControlError
from tools.waiting import wait_until

RIG = """
device: {{name: rig-t}}
cameras: {{driver: sim}}
simulation: {{scene: plane, frames: 2, rate_hz: 20.0, layout: {{scale: 0.0625}}, cache_dir: cache}}
stream: {{endpoints: ["ipc://{tmp}/s"], preview_hz: 10.0}}
control: {{endpoint: "ipc://{tmp}/c"}}
recording: {{dir: takes, min_free_mb: 1, before_s: 5.0}}
"""


@contextmanager
def measuring(folder: Path, rig: str = RIG) -> Iterator[str]:
    """A daemon that has measured some clouds; gives its control endpoint."""
    path = folder / "rig.yaml"
    path.write_text(rig.format(tmp=folder))
    control, flag = f"ipc://{folder}/c", run.StopFlag()
    thread = threading.Thread(target=run.run_rig, args=(path,), kwargs={"flag": flag})
    logger = logging.getLogger("fringed")
    level = logger.level
    logger.setLevel(logging.INFO)  # as `fringed run` does
    thread.start()
    try:
        with ControlClient(control, timeout_s=30.0) as client:

            def measures() -> bool:
                assert thread.is_alive()
                with suppress(ControlError):
                    return bool(client.call("status")["clouds"] > 2)
                return False

            wait_until(measures, 90, "clouds of the simulated rig")
        yield control
    finally:
        logger.setLevel(level)
        flag.request()
        thread.join(60)
        assert not thread.is_alive()
