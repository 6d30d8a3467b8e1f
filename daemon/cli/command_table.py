"""The table of commands; a command's module is imported only when it is used."""

from __future__ import annotations

import difflib
import importlib
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

COMMANDS: dict[str, tuple[str, str]] = {
    "run": ("daemon.cli.measure.run", "Measure: run the daemon of a rig."),
    "demo": ("daemon.cli.measure.demo", "Try it: a simulated rig, measured live, in a viewer."),
    "view": ("daemon.cli.measure.view", "Show the stream of a daemon in the Rerun viewer."),
    "listen": ("daemon.cli.measure.listen", "Print rate, points, latency and losses of a stream."),
    "status": ("daemon.cli.control.status", "Show the status of a running daemon."),
    "health": ("daemon.cli.control.health", "Report the health of a running daemon; charts of the last hours."),
    "mode": ("daemon.cli.control.mode", "Show or change the mode: the number of images per cloud."),
    "get": ("daemon.cli.control.get", "List the settings of a running daemon, or show one."),
    "set": ("daemon.cli.control.set:app", "Change a setting while the daemon measures."),
    "preset": ("daemon.cli.control.preset:app", "List, save and use presets of the reconstruction."),
    "reload": ("daemon.cli.control.switches:reload", "Make a running daemon read its rig.yaml and files again."),
    "start": ("daemon.cli.control.switches:start", "Resume measuring in a paused daemon."),
    "stop": ("daemon.cli.control.switches:stop", "Pause a daemon; everything stays connected."),
    "snapshot": ("daemon.cli.control.switches:snapshot", "Write the newest cloud of a running daemon to a file."),
    "pattern": ("daemon.cli.control.switches:pattern", "Show the fringe or a plain image on the projector."),
    "record": ("daemon.cli.control.record:app", "Record raw images: start, stop, or directly from the rig."),
    "takes": ("daemon.cli.takes.takes:app", "List, show, check, repair and remove takes."),
    "replay": ("daemon.cli.takes.replay:app", "Reconstruct a recorded take."),
    "reprocess": ("daemon.cli.takes.reprocess:app", "Reconstruct many takes, on all processors or a cluster."),
    "worker": ("daemon.cli.takes.worker", "Start worker processes for `fringed reprocess --scheduler`."),
    "info": ("daemon.cli.takes.info", "Show the contents of a take and whether it is complete."),
    "check": ("daemon.cli.setup.check", "Check a rig.yaml, a calibration or a take."),
    "doctor": ("daemon.cli.setup.doctor", "Find problems of the machine or a rig, and their remedies."),
    "devices": ("daemon.cli.setup.devices", "List cameras and projector outputs with their keys in rig.yaml."),
    "projector": ("daemon.cli.setup.projector:app", "Find the projector's output and show test images on it."),
    "calibrate": ("daemon.cli.calibrate.group:app", "Calibrate cameras, projector and colours, and check them."),
    "keys": ("daemon.cli.setup.keys:app", "Manage access from other machines: make, allow, list and revoke keys."),
    "install": ("daemon.cli.setup.install", "Install the daemon on this machine as a systemd service."),
    "uninstall": ("daemon.cli.setup.uninstall", "Remove the service; data and configuration are kept."),
    "export": ("daemon.cli.takes.export", "Convert clouds to PLY, PCD or a video."),
}


_RESOLVING = "fringed.resolving"


class LazyGroup(TyperGroup):
    """Lists the table in the help and imports a command when it runs."""

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002
        """Every name, in the order of the table."""
        return list(COMMANDS)

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """A placeholder with the one-line help for the overview, else the imported command."""
        if cmd_name not in COMMANDS:
            return None
        target, summary = COMMANDS[cmd_name]
        if ctx.invoked_subcommand is None and not ctx.meta.get(_RESOLVING):
            return TyperCommand(cmd_name, help=summary)
        return load(cmd_name, target, summary)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Find the named command; from here on it is imported."""
        ctx.meta[_RESOLVING] = True
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            near = difflib.get_close_matches(args[0], COMMANDS, n=1)
            hint = f"did you mean {near[0]!r}?" if near else f"there are: {', '.join(COMMANDS)}"
            ctx.fail(f"there is no command {args[0]!r}; {hint}")
        return super().resolve_command(ctx, args)


def load(name: str, target: str, summary: str) -> Any:
    """Import a command: the function or typer app after the colon, ``main`` without a colon."""
    module, _, attribute = target.partition(":")
    command: Any = getattr(importlib.import_module(module), attribute or "main")
    app = command
    if not isinstance(command, typer.Typer):
        app = typer.Typer(add_completion=False)
        app.command(name=name, help=command.__doc__ or summary)(command)
    loaded = typer.main.get_command(app)
    loaded.name = name
    return loaded


# Every command inherits the names of the option.
_HELP = {"help_option_names": ["-h", "--help"]}
app = typer.Typer(
    cls=LazyGroup, add_completion=False, no_args_is_help=True, rich_markup_mode=None, context_settings=_HELP
)


def _print_version(wanted: bool) -> None:
    if wanted:
        from daemon.common.version import program_version

        typer.echo(f"fringed {program_version()}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", "-V", callback=_print_version, is_eager=True, help="Print the version.")
    ] = False,
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
            return _report(error)
        raise
    return result if isinstance(result, int) and not isinstance(result, bool) else 0


def _report(error: Any) -> int:
    """Print a usage error as one sentence with its command, or a group's help; return its exit status."""
    if type(error).__name__ == "NoArgsIsHelpError":  # its message is the help of a group without a command
        typer.echo(error.format_message(), err=True)
        return int(error.exit_code)
    context = getattr(error, "ctx", None)
    command = context.command_path if context is not None else "fringed"
    message = " ".join(error.format_message().split()).rstrip(".").replace(". Did you", "; did you")
    typer.echo(f"fringed: {message[:1].lower()}{message[1:]}; see `{command} -h`", err=True)
    return int(error.exit_code)
