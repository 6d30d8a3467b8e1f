"""The outputs of an X display, read in a process of its own: an X error cannot end this one."""

from __future__ import annotations

import subprocess
import sys

import msgspec

from drivers.child_process import environment, interpreter
from drivers.errors import DriverError
from drivers.projector.options import named_display
from drivers.projector.x11.detected_output import DetectedOutput

TIMEOUT_S = 15.0
MODULE = "drivers.projector.x11.listing"


class Listing(msgspec.Struct):
    """Result of the listing process: the outputs, or why there are none."""

    outputs: list[DetectedOutput] = []
    problem: str = ""


def outputs(display: str = "") -> list[DetectedOutput]:
    """List the RandR outputs of an X display.

    Args:
        display: such as ``:0``; empty = the environment's DISPLAY.

    Raises:
        DriverError: no such display, or no RandR.
    """
    name = named_display(display)
    try:
        process = subprocess.run(  # noqa: S603 - this program, fixed arguments
            [*interpreter(), "-m", MODULE, name],
            capture_output=True,
            timeout=TIMEOUT_S,
            check=False,
            env=environment(),
            stdin=subprocess.DEVNULL,
        )
    except subprocess.TimeoutExpired:
        raise DriverError(f"X display {name} does not answer within {TIMEOUT_S:.0f} s") from None
    try:
        listing = msgspec.json.decode(process.stdout, type=Listing)
    except msgspec.DecodeError:
        error = process.stderr.decode(errors="replace").strip()[-500:]
        raise DriverError(f"X display {name} cannot be read: {error or f'exit status {process.returncode}'}") from None
    if listing.problem:
        raise DriverError(listing.problem)
    return listing.outputs


def read(display: str) -> Listing:
    """List the outputs in this process."""
    from drivers.projector.x11.randr import Randr
    from drivers.projector.x11.xlib import Connection, catch_errors

    try:
        catch_errors()
        connection = Connection(display)
        try:
            return Listing(outputs=Randr(connection).outputs(probe=True))
        finally:
            connection.close()
    except DriverError as error:
        return Listing(problem=str(error))


if __name__ == "__main__":
    sys.stdout.buffer.write(msgspec.json.encode(read(sys.argv[1])))
