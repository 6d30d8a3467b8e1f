"""``fringed demo``: a simulated rig, measured live, with a viewer, without configuration."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Annotated, Any

import typer

SMALL_SCALE = 0.25


def main(
    scene: Annotated[str, typer.Option(help="Scene of the simulated rig: moving, face, spheres, ...")] = "moving",
    mesh: Annotated[Path | None, typer.Option(help="Show this OBJ, PLY or STL file instead.")] = None,
    frames: Annotated[
        int,
        typer.Option(min=1, max=1000, help="Number of images; the first is measured while the others are rendered."),
    ] = 12,
    rate: Annotated[float, typer.Option(min=0.1, max=200, help="Triggers per second.")] = 5.0,
    seconds: Annotated[float | None, typer.Option(min=1, help="Stop after this time.")] = None,
    view: Annotated[bool, typer.Option(help="Serve the viewer to a browser.")] = True,
    small: Annotated[bool, typer.Option(help="Images of 256 x 205 pixels instead of 1024 x 820.")] = False,
    live: Annotated[
        bool, typer.Option("--live", help="Render each image as it is projected: slower, with every mode and pattern.")
    ] = False,
    verbose: Annotated[bool, typer.Option("--verbose", "-v", help="Print more messages.")] = False,
) -> None:
    """Measure a simulated rig live and show it in a viewer, until Ctrl-C."""
    simulation = options(scene, mesh, frames, rate, small=small, live=live)
    check_options(simulation)  # before the imports, which take longer
    import logging

    from daemon.bootstrap.run import StopFlag, run_rig
    from daemon.bootstrap.systemd.logging_setup import log_events
    from daemon.cli.measure.demo_processes import Report, Viewer
    from daemon.cli.options.progress import rendering
    from daemon.common.errors import ConfigError, InputError
    from daemon.kernels.jobs import measuring_jobs
    from daemon.kernels.processes import compiling_ahead
    from fringed.control.address import control_endpoint, runtime_dir

    log_events(logging.INFO if verbose else logging.WARNING)
    with ExitStack() as stack:
        flag = stack.enter_context(StopFlag().on_signals())
        directory = _private_directory(runtime_dir())
        stack.callback(shutil.rmtree, directory, ignore_errors=True)
        rig_file, endpoint, control = write_rig(directory, simulation)
        viewer = Viewer(endpoint) if view else None
        if viewer is not None:
            stack.callback(viewer.close)
        report = Report(seconds, stop=flag.request, viewer=viewer, echo=typer.echo, now_s=time.monotonic)
        stack.enter_context(compiling_ahead(measuring_jobs("rgb8")))
        progress = stack.enter_context(rendering())
        typer.echo("Rendering the scene (cached for the next start), then measuring it live. Ctrl-C ends the demo.")
        option = "" if control == control_endpoint() else f" --endpoint {control}"
        typer.echo(f"It is a whole daemon: fringed status{option}; also get, set, mode, record, snapshot.")
        try:
            run_rig(rig_file, progress=progress, flag=flag, on_status=report, hold_cameras=True)
        except ConfigError as error:  # the person has never seen the demo's rig file
            position = re.compile(rf"{re.escape(str(rig_file))}:\d+:\d+: ")
            raise InputError("; ".join(position.sub("", problem) for problem in error.problems)) from error


def options(
    scene: str, mesh: Path | None, frames: int, rate: float, *, small: bool, live: bool = False
) -> dict[str, Any]:
    """The ``simulation`` section of the demo's rig."""
    section: dict[str, Any] = {"scene": scene, "frames": frames, "rate_hz": rate}
    if mesh is not None:
        section |= {"scene": "mesh", "mesh": str(mesh.resolve())}
    section["live" if live else "background"] = True
    if small:
        section["layout"] = {"scale": SMALL_SCALE}
    return section


def check_options(simulation: dict[str, Any]) -> None:
    """Check the options before anything is made of them.

    Raises:
        InputError: the first mistake, named as the option of the command line.
    """
    from daemon.common.errors import InputError
    from daemon.config.simulation import simulation_problems

    for path, message in simulation_problems({"cameras": {"driver": "sim"}, "simulation": simulation}, Path()):
        raise InputError(message.replace(f"simulation.{path[-1]}", f"--{path[-1]}", 1))


def write_rig(directory: Path, simulation: dict[str, Any]) -> tuple[Path, str, str]:
    """Write rig.yaml into a directory; returns its path and the ipc endpoints of stream and control.

    Control has the default address, where the commands expect a daemon, unless another daemon runs there.
    """
    from fringed.control.address import control_endpoint
    from fringed.control.connection import check_address

    endpoint, control = f"ipc://{directory / 'stream'}", control_endpoint()
    if not check_address(control):
        control = f"ipc://{directory / 'control'}"
    rig = {
        "device": {"name": "demo"},
        "cameras": {"driver": "sim"},
        "simulation": simulation,
        "stream": {"endpoints": [endpoint, _free_tcp()]},
        "control": {"endpoint": control},
        "recording": {"dir": str(Path.cwd() / "takes")},
    }
    path = directory / "rig.yaml"
    path.write_text(json.dumps(rig, indent=2), encoding="utf-8")  # JSON is YAML
    return path, endpoint, control


def _private_directory(base: Path) -> Path:
    base.mkdir(mode=0o700, parents=True, exist_ok=True)
    return Path(tempfile.mkdtemp(prefix="demo-", dir=base))


def _free_tcp() -> str:
    """The default address, or any free port if it is in use."""
    import socket

    with socket.socket() as probe:
        try:
            probe.bind(("127.0.0.1", 5555))
        except OSError:
            return "tcp://127.0.0.1:*"
    return "tcp://127.0.0.1:5555"
