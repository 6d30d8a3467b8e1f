"""The page of the web viewer, for this machine only: ``python -m daemon.apps.viewer.web_page PORT DATA_PORT PARENT``.

Rerun's library serves the page on every network interface; its program has an option for one. This process becomes that
program, which ends with its parent.
"""

from __future__ import annotations

import os
import sys

from daemon.apps.viewer.rerun_targets import viewer_program
from drivers.child_process import die_with_parent

HOST = "127.0.0.1"


def command(page: int, data: int) -> list[str]:
    """The program and its arguments."""
    address = f"rerun+http://{HOST}:{data}/proxy"
    return [str(viewer_program()), "--serve-web", "--bind", HOST, "--web-viewer-port", str(page), address]


def main(arguments: list[str]) -> None:
    """Replace this process by the viewer's program."""
    page, data, parent = (int(text) for text in arguments)
    die_with_parent(parent)
    os.environ.setdefault("RUST_LOG", "error")
    program = command(page, data)
    os.execv(program[0], program)  # noqa: S606 - a fixed program, no shell


if __name__ == "__main__":
    main(sys.argv[1:])
