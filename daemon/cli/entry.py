"""The console command ``fringed``: starts quickly, and reports missing packages in one sentence."""

from __future__ import annotations

import os
import sys

from daemon.cli.allocator import prepare

_INSTALL = (
    "fringed: the commands require the packages of a rig PC ({name} is missing); install them with: pip install "
    "'fringed[rig]'. Reading a stream from Python requires none of them: from fringed import subscribe"
)
_OWN = ("daemon", "sim", "drivers", "pipeline", "fringed")


def main() -> None:
    """Run the command line; the exit status is 0, 1 for an expected error, 2 for wrong usage."""
    prepare()
    sys.exit(run(sys.argv[1:]))


def run(arguments: list[str]) -> int:
    """Run one command line and return its exit status."""
    debug = "--debug" in arguments or bool(os.environ.get("FRINGED_DEBUG"))
    arguments = [argument for argument in arguments if argument != "--debug"]
    try:
        from daemon.cli import command_table

        return command_table.invoke(arguments)
    except ModuleNotFoundError as error:
        if debug or (error.name or "").partition(".")[0] in _OWN:
            raise
        print(_INSTALL.format(name=error.name), file=sys.stderr)  # noqa: T201 - the only output without further packages
        return 1
    except Exception as error:
        if debug or not _expected(error):
            raise
        print(f"fringed: {error}", file=sys.stderr)  # noqa: T201
        return 1


def _expected(error: Exception) -> bool:
    """Whether it is an error of this project or of the operating system; compared by name to import nothing heavy."""
    if isinstance(error, OSError):
        return True
    names = {f"{kind.__module__}.{kind.__qualname__}" for kind in type(error).__mro__}
    return bool(names & _EXPECTED)


_EXPECTED = {
    "daemon.common.errors.DaemonError",
    "drivers.errors.DriverError",
    "pipeline.common.errors.PipelineError",
    "fringed.errors.FringedError",
    "sim.devices.options.OptionError",
    "zmq.error.ZMQError",
}
