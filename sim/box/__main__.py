"""``python -m sim.box [--config box.yaml] [--no-daemon]``: a rig on emulated hardware, measured live until Ctrl-C.

Starts an X server without hardware, emulated cameras and the light between them, and the daemon on that rig; prints
the commands to watch it. Nothing is left behind.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import FrameType

from drivers.errors import DriverError
from sim.box.box import GENTL_DIR, OUTPUT, Box
from sim.box.options import BoxOptions, read
from sim.box.xserver import XServerError
from sim.devices.options import OptionError
from sim.gentl.build import BuildError

_DAEMON = "import sys; from daemon.cli.entry import main; sys.argv[0] = 'fringed'; main()"
_STOP_S = 20.0


def main(arguments: list[str]) -> int:
    """Run until a signal; 0, or 1 when something is missing or the daemon ended by itself."""
    parser = argparse.ArgumentParser(prog="python -m sim.box", description=(__doc__ or "").partition("\n\n")[2])
    parser.add_argument("--config", type=Path, help="YAML file with the box's options")
    parser.add_argument("--no-daemon", action="store_true", help="only the devices; the daemon is started separately")
    given = parser.parse_args(arguments)
    try:
        options = read(given.config) if given.config else BoxOptions()
        return run(replace(options, daemon=options.daemon and not given.no_daemon))
    except (OptionError, BuildError, XServerError, DriverError, OSError) as error:
        sys.stderr.write(f"sim.box: {error}\n")
        return 1


def run(options: BoxOptions) -> int:
    """Start the box, print its ready line, and trigger until SIGINT or SIGTERM."""
    stop = threading.Event()
    with ExitStack() as stack:
        stack.enter_context(_on_signals(stop.set))
        sys.stdout.write("starting the box: X server, cameras, scene\n")
        sys.stdout.flush()
        box = stack.enter_context(Box(options))
        daemon = _start_daemon(box, stack) if options.daemon else None
        sys.stdout.write(_description(box))
        sys.stdout.flush()
        watch = threading.Thread(target=_watch, args=(daemon, stop), daemon=True)
        watch.start()
        box.world.run(options.simulation.rate_hz, stop)
        ended = daemon is not None and daemon.poll() is not None
    late = f", {box.world.late} skipped because this machine was busy" if box.world.late else ""
    sys.stdout.write(f"{box.world.triggers} triggers given{late}; everything is closed\n")
    return 1 if ended else 0


class _on_signals:  # noqa: N801 - reads as a verb
    """Inside the block SIGINT and SIGTERM call a function."""

    def __init__(self, action: Callable[[], None]) -> None:
        self._action = action

    def __enter__(self) -> None:
        def handle(_: int, __: FrameType | None) -> None:
            self._action()

        self._before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


def _start_daemon(box: Box, stack: ExitStack) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", _DAEMON, "run", str(box.rig_file)]
    environment = os.environ | {GENTL_DIR: str(box.gentl_dir)}
    # Ctrl-C reaches the whole process group; in its own session the daemon is ended in order by this process.
    process = subprocess.Popen(command, env=environment, start_new_session=True)  # noqa: S603 - a fixed list, no shell
    stack.callback(_end, process)
    return process


def _end(process: subprocess.Popen[bytes]) -> None:
    if process.poll() is None:
        process.send_signal(signal.SIGTERM)
        try:
            process.wait(_STOP_S)
        except subprocess.TimeoutExpired:
            process.kill()
    process.wait()


def _watch(daemon: subprocess.Popen[bytes] | None, stop: threading.Event) -> None:
    """Stop once the daemon has ended."""
    while daemon is not None and not stop.wait(0.5):
        if daemon.poll() is not None:
            stop.set()


def _description(box: Box) -> str:
    options, folder = box.options, box.folder
    width, height = options.layout.camera_size
    stream = f"tcp://127.0.0.1:{options.tcp}" if options.tcp else f"ipc://{folder}/stream"
    lines = [
        f"ready: {width} x {height} pixels, {options.simulation.scene}, {options.simulation.rate_hz:g} triggers a "
        f"second, {options.simulation.encoding}, projector {OUTPUT} of {box.display}, rig {box.rig_file}",
        f"  fringed status --endpoint ipc://{folder}/control",
        f"  fringed listen {stream}",
        f"  fringed view {stream}",
    ]
    if not options.daemon:
        lines.append(f"  {GENTL_DIR}={box.gentl_dir} fringed run {box.rig_file}")
    return "\n".join([*lines, "Ctrl-C ends it", ""])


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
