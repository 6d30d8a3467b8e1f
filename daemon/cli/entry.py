"""The console command ``fringed``: starts quickly, and reports missing packages in one sentence."""

from __future__ import annotations

import gc
import os
import sys
import warnings

from daemon.cli.allocator import prepare
from daemon.kernels.release import select

_INSTALL = (
    "fringed: the commands require the packages of a rig PC ({name} is missing); install them with: pip install "
    "fringed-rig. Reading a stream from Python requires none of them: from fringed import subscribe"
)
_VIEW = "fringed: the viewer requires Rerun, which is not installed: pip install 'fringed-rig[view]'"
_INPUT_STATUS = 2
_OWN = ("daemon", "sim", "drivers", "pipeline", "fringed")


def main() -> None:
    """Run the command line; the exit status is 0, 1 for an expected failure, 2 for an input that cannot be used."""
    prepare()
    select()
    try:
        sys.exit(run(sys.argv[1:]))
    finally:
        # The garbage collection at the interpreter's end takes half a second for the objects of the compiler.
        gc.freeze()


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status."""
    debug = "--debug" in arguments or bool(os.environ.get("FRINGED_DEBUG"))
    arguments = [argument for argument in arguments if argument != "--debug"]
    warnings.showwarning = _show_warning
    try:
        from daemon.cli import command_table

        return command_table.invoke(arguments)
    except ModuleNotFoundError as error:
        if debug or (error.name or "").partition(".")[0] in _OWN:
            raise
        message = _VIEW if (error.name or "").partition(".")[0] == "rerun" else _INSTALL.format(name=error.name)
        print(message, file=sys.stderr)  # noqa: T201 - the only output without further packages
        return _INPUT_STATUS
    except Exception as error:
        if debug or not _is_one_of(error, _EXPECTED):
            raise
        print(f"fringed: {_sentence(error)}", file=sys.stderr)  # noqa: T201
        return _INPUT_STATUS if _is_one_of(error, _INPUT) and not _is_one_of(error, _REFUSED) else 1


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning, of a setting's former name for example, as one sentence."""
    print(f"fringed: {message}", file=sys.stderr)  # noqa: T201


def _is_one_of(error: Exception, names: set[str]) -> bool:
    """Whether it is an error of these classes; compared by name to import nothing heavy."""
    return bool(names & {f"{kind.__module__}.{kind.__qualname__}" for kind in type(error).__mro__})


def _sentence(error: Exception) -> str:
    """The message; that of the operating system as ``FILE: reason``."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return f"{os.fsdecode(error.filename)}: {error.strerror[:1].lower()}{error.strerror[1:]}"
    return str(error)


_INPUT = {
    "builtins.FileExistsError",
    "builtins.FileNotFoundError",
    "builtins.IsADirectoryError",
    "builtins.NotADirectoryError",
    "builtins.PermissionError",
    "daemon.common.errors.ConfigError",
    "daemon.common.errors.InputError",
    "daemon.recording.format.errors.TakeError",
    "fringed.errors.FringedError",
    "pipeline.common.errors.PipelineError",
    "sim.devices.options.OptionError",
}
"""Errors about what the command line names: a file, an address, a setting."""

_REFUSED = {"fringed.errors.RefusedError"}
"""Answers of a daemon, which are no errors of the input."""

_EXPECTED = {
    "builtins.OSError",
    "daemon.common.errors.DaemonError",
    "drivers.errors.DriverError",
    "pipeline.common.errors.PipelineError",
    "fringed.errors.FringedError",
    "sim.devices.options.OptionError",
    "zmq.error.ZMQError",
}
