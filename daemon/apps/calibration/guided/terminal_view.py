"""How a session goes, on a terminal (one live line and a bar) or as plain lines."""

from __future__ import annotations

import sys
from typing import Any, Self, TextIO

from daemon.apps.calibration.guided.capture_loop import Scene, Watcher
from daemon.apps.calibration.guided.session_state import State


class Lines:
    """A line whenever something else is to be done; for logs and for programs."""

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = out or sys.stderr
        self._last = ""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Nothing to clean up."""

    def seen(self, scene: Scene) -> None:
        """Say what to do, once."""
        text = scene.told.text
        if scene.told.accepted is not None:
            text = f"view {len(scene.session.views)} of {scene.session.limits.wanted} is {text}"
        self._say(text)

    def capturing(self, done: int, of: int) -> None:
        """Every fourth part of a long sequence."""
        if of > 1 and (done * 4) // of > ((done - 1) * 4) // of:
            self._say(f"image {done} of {of}")

    def trouble(self, text: str) -> None:
        """Say it."""
        self._say(text)

    def _say(self, text: str) -> None:
        if text != self._last:
            self._last = text
            self._out.write(text + "\n")
            self._out.flush()


class Bars:
    """A bar of the views, a bar of what goes on now, and the last instruction."""

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

    def seen(self, scene: Scene) -> None:
        """Bars and words."""
        session, told = scene.session, scene.told
        count = f"{len(session.views)} of {session.limits.wanted} views, {session.refused} not taken"
        self._bars.update(self._views, completed=len(session.views), total=session.limits.wanted, description=count)
        if told.accepted is not None:
            self._bars.console.bell()  # whoever holds the board may not see the screen
        name = "hold" if session.state in (State.LOOKING, State.STEADYING) else str(session.state)
        self._bars.update(self._now, completed=told.steady, total=1, description=told.text, name=name)

    def capturing(self, done: int, of: int) -> None:
        """The sequence's bar."""
        self._bars.update(self._now, completed=done, total=of, name="images", description=f"{done} of {of}")

    def trouble(self, text: str) -> None:
        """In the place of the instruction."""
        self._bars.update(self._now, completed=0, description=text)


class Several:
    """Several watchers as one."""

    def __init__(self, *watchers: Watcher) -> None:
        self._watchers = watchers

    def seen(self, scene: Scene) -> None:
        """Tell all of them."""
        for watcher in self._watchers:
            watcher.seen(scene)

    def capturing(self, done: int, of: int) -> None:
        """Tell all of them."""
        for watcher in self._watchers:
            watcher.capturing(done, of)

    def trouble(self, text: str) -> None:
        """Tell all of them."""
        for watcher in self._watchers:
            watcher.trouble(text)


def terminal() -> Lines | Bars:
    """What suits standard error."""
    return Bars() if sys.stderr.isatty() else Lines()
