"""Errors of the daemon and its commands."""

from __future__ import annotations


class DaemonError(RuntimeError):
    """Root of the daemon's errors; the message is one plain sentence for the person at the terminal."""


class ConfigError(DaemonError):
    """A rig.yaml that cannot be used; ``problems`` holds one line for each mistake."""

    def __init__(self, problems: list[str]) -> None:
        self.problems = problems
        super().__init__("\n".join(problems))


class InputError(DaemonError):
    """Something that the command line names is missing, of the wrong kind, or contradicts the rest of it."""
