"""Commands of the rig that set a projector up: fixed argument lists, bounded in time, never a shell."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from drivers.errors import DriverError

OUTPUT_BYTES = 300


def run_hooks(
    commands: tuple[tuple[str, ...], ...], *, timeout_s: float, directory: Path, variables: Mapping[str, str]
) -> None:
    """Run commands one after the other.

    Args:
        commands: program and arguments of each.
        timeout_s: limit for each; then it is killed with all its children.
        directory: their working directory, so that relative paths start at rig.yaml.
        variables: added to their environment.

    Raises:
        DriverError: a command does not exist, took too long or did not end with 0; the others are not run.
    """
    for command in commands:
        _run(command, timeout_s, directory, variables)


def _run(command: tuple[str, ...], timeout_s: float, directory: Path, variables: Mapping[str, str]) -> None:
    name = f"projector hook {' '.join(command)!r:.200}"
    with tempfile.TemporaryFile() as output:  # a pipe would wait for processes that the command leaves running
        try:
            process = subprocess.Popen(  # noqa: S603 - a list from rig.yaml, no shell
                command,
                cwd=directory,
                env={**os.environ, **variables},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            raise DriverError(f"{name} cannot be started: {error.strerror or error}") from None
        try:
            status = process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            raise DriverError(f"{name} did not end within {timeout_s:g} s (projector.hook.timeout_s)") from None
        if status:
            output.seek(max(0, output.seek(0, os.SEEK_END) - OUTPUT_BYTES))
            text = output.read().decode(errors="replace").strip()
            raise DriverError(f"{name} ended with {status}{f': {text}' if text else ''}")
