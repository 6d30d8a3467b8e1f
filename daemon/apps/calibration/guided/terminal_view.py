"""Displays of a session: progress bars on a terminal, or plain lines."""

from __future__ import annotations

import sys
from typing import Any, Self, TextIO

from daemon.apps.calibration.guided.capture_loop import SessionDisplay, SessionUpdate
from daemon.apps.calibration.guided.session_state import State


class PlainDisplay:
    """Writes a line for every new instruction; for logs and programs."""

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = out or sys.stderr
        self._last = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to clean up."""

    def show(self, update: SessionUpdate) -> None:
        """Write the instruction, once."""
        text = update.instruction.text
        if update.instruction.accepted is not None:
            text = f"view {len(update.session.views)} of {update.session.limits.least} {text}"
        self._write(text)

    def capturing(self, completed: int, total: int) -> None:
        """Write the progress after every quarter of a sequence."""
        if total > 1 and (completed * 4) // total > ((completed - 1) * 4) // total:
            self._write(f"image {completed} of {total}")

    def failure(self, text: str) -> None:
        """Write the reason."""
        self._write(text)

    def _write(self, text: str) -> None:
        if text != self._last:
            self._last = text
            self._out.write(text + "\n")
            self._out.flush()


class ProgressDisplay:
    """A bar of the views, a bar of the current activity, and the last instruction."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        columns = TextColumn("{task.fields[name]:>8}"), BarColumn(), TextColumn("{task.description}")
        self._bars: Any = Progress(*columns, console=Console(stderr=True))
        self._views = self._bars.add_task("", total=1, name="views")
        self._now = self._bars.add_task("", total=1, name="hold")

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def show(self, update: SessionUpdate) -> None:
        """Update both bars and the instruction."""
        session, instruction = update.session, update.instruction
        count = f"{len(session.views)} of {session.limits.least} views, {session.rejected} not accepted"
        self._bars.update(self._views, completed=len(session.views), total=session.limits.least, description=count)
        if instruction.accepted is not None:
            self._bars.console.bell()  # the person with the board may not see the screen
        name = "hold" if session.state in (State.SEARCHING, State.STEADYING) else str(session.state)
        self._bars.update(self._now, completed=instruction.steady, total=1, description=instruction.text, name=name)

    def capturing(self, completed: int, total: int) -> None:
        """Update the bar of the sequence."""
        text = f"{completed} of {total}"
        self._bars.update(self._now, completed=completed, total=total, name="images", description=text)

    def failure(self, text: str) -> None:
        """Write the reason in place of the instruction."""
        self._bars.update(self._now, completed=0, description=text)


class CombinedDisplay:
    """Several displays combined."""

    def __init__(self, *displays: SessionDisplay) -> None:
        self._displays = displays

    def show(self, update: SessionUpdate) -> None:
        """Pass the call to all displays."""
        for display in self._displays:
            display.show(update)

    def capturing(self, completed: int, total: int) -> None:
        """Pass the call to all displays."""
        for display in self._displays:
            display.capturing(completed, total)

    def failure(self, text: str) -> None:
        """Pass the call to all displays."""
        for display in self._displays:
            display.failure(text)


def terminal_display() -> PlainDisplay | ProgressDisplay:
    """The display for standard error: bars on a terminal, plain lines otherwise."""
    return ProgressDisplay() if sys.stderr.isatty() else PlainDisplay()
