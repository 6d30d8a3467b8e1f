"""The table of commands; each command's module is imported only when that command is named."""

from __future__ import annotations

import importlib
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("daemon.cli.measure.run", "Measure: run the daemon of a rig."),
    "demo": ("daemon.cli.measure.demo", "See it work: a simulated rig, measured live, in a viewer."),
    "view": ("daemon.cli.measure.view", "Watch the stream of a daemon in the Rerun viewer."),
    "listen": ("daemon.cli.measure.listen", "Print rate, points, latency and losses of a stream."),
    "status": ("daemon.cli.control.status", "Show what a running daemon is doing."),
    "health": ("daemon.cli.control.health", "Tell how a running daemon fares; charts of the last hours."),
    "mode": ("daemon.cli.control.mode", "Tell or change how many images make a cloud."),
    "get": ("daemon.cli.control.get", "List the settings of a running daemon, or show one."),
    "set": ("daemon.cli.control.set", "Change a setting while the daemon measures."),
    "reload": ("daemon.cli.control.switches:reload", "Let a running daemon read its rig.yaml and files again."),
    "start": ("daemon.cli.control.switches:start", "Let a paused daemon measure again."),
    "stop": ("daemon.cli.control.switches:stop", "Let a daemon pause; everything stays connected."),
    "snapshot": ("daemon.cli.control.switches:snapshot", "Write the newest cloud of a running daemon to a file."),
    "pattern": ("daemon.cli.control.switches:pattern", "Show the fringe or a plain image on the projector."),
    "record": ("daemon.cli.control.record", "Record raw images: start, stop, or directly from the rig."),
    "takes": ("daemon.cli.takes.takes", "List, show, check, repair and remove takes."),
    "replay": ("daemon.cli.takes.replay", "Reconstruct a recorded take."),
    "info": ("daemon.cli.takes.info", "Tell what a take holds and whether it is whole."),
    "check": ("daemon.cli.setup.check", "Check a rig.yaml, a calibration or a take."),
    "doctor": ("daemon.cli.setup.doctor", "Find what is wrong with the machine or a rig, and how to mend it."),
    "devices": ("daemon.cli.setup.devices", "List cameras and projector outputs, with what rig.yaml calls them by."),
    "projector": ("daemon.cli.setup.projector", "Find the projector's output and show test images on it."),
    "calibrate": ("daemon.cli.calibrate.group", "Calibrate cameras, projector and colours, and check them."),
    "keys": ("daemon.cli.setup.keys", "Say who may connect from other machines: make, allow, list and revoke keys."),
    "install": ("daemon.cli.setup.install", "Put the daemon onto this machine as a systemd service."),
    "uninstall": ("daemon.cli.setup.uninstall", "Take the service away; data and configuration stay."),
    "export": ("daemon.cli.takes.export", "Turn clouds into PLY, PCD or a video."),
}


_RESOLVING = "fringed.resolving"


class LazyGroup(TyperGroup):
    """Shows the table in the help; imports a command when it is to run."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Every name, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A stand-in with the one-line help while the overview is printed, else the real command."""
        if cmd_name not in COMMANDS:
            return None
        module, summary = COMMANDS[cmd_name]
        if ctx.invoked_subcommand is None and not ctx.meta.get(_RESOLVING):
            return TyperCommand(cmd_name, help=summary)
        return load(cmd_name, module, summary)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the command that was named; from here on the real one is wanted."""
        ctx.meta[_RESOLVING] = True
        return super().resolve_command(ctx, args)


def load(name: str, module: str, summary: str) -> Any:
    """Import a command's module: its ``app`` (with sub-commands), its ``main``, or the function after a colon."""
    module, _, function = module.partition(":")
    loaded = importlib.import_module(module)
    app = None if function else getattr(loaded, "app", None)
    if app is None:
        main = getattr(loaded, function or "main")
        app = typer.Typer(add_completion=False)
        app.command(name=name, help=(main.__doc__ or summary))(main)
    command = typer.main.get_command(app)
    command.name = name
    return command


app = typer.Typer(cls=LazyGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None)


@app.callback()
def _root(
    debug: Annotated[bool, typer.Option("--debug", help="Show tracebacks.")] = False,
) -> None:
    """Live 3D measurement: two colour cameras, one projected image, a metric cloud per frame."""


def invoke(arguments: list[str]) -> int:
    """Run one command line; usage errors are printed and give 2."""
    try:
        result = app(args=arguments, prog_name="fringed", standalone_mode=False)
    except typer.Exit as stop:
        return int(stop.exit_code)
    except (typer.Abort, KeyboardInterrupt):
        return 130
    except Exception as error:
        if hasattr(error, "show") and hasattr(error, "exit_code"):  # typer has no public name for its usage errors
            error.show()
            return int(error.exit_code)
        raise
    return result if isinstance(result, int) and not isinstance(result, bool) else 0
