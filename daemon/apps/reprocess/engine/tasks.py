"""What a run asks of an engine, and the engine that works in this process."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

from daemon.common.errors import DaemonError


class EngineLostError(DaemonError):
    """The engine is gone; nothing more can be computed, and what is finished stays."""


@dataclass(frozen=True, slots=True)
class Completed:
    """The end of a task: its label and value, or the reason why there is none."""

    label: Any
    value: Any = None
    error: str = ""


class Engine(Protocol):
    """Runs functions of modules, each call once or, when a worker dies, again."""

    @property
    def slots(self) -> int:
        """Tasks that run at the same time."""

    def submit(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Hand over a call; its end is reported with this label."""

    def wait(self, timeout_s: float) -> list[Completed]:
        """Wait until a task ends, at most so long; return those that ended.

        Raises:
            EngineLostError: no task will ever end.
        """


class InlineEngine:
    """Runs one task after the other in this process, during :meth:`wait`."""

    slots = 1

    def __init__(self) -> None:
        self._calls: deque[tuple[Any, Callable[..., Any], tuple[Any, ...]]] = deque()

    def submit(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Put a call into the queue."""
        self._calls.append((label, function, arguments))

    def wait(self, timeout_s: float) -> list[Completed]:  # noqa: ARG002 - the call itself is waited for
        """Run the next call."""
        if not self._calls:
            return []
        label, function, arguments = self._calls.popleft()
        return [Completed(label, function(*arguments))]
