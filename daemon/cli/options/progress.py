"""Progress of long tasks: a bar on a terminal, plain lines otherwise."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def rendering(title: str = "Rendering the simulated rig") -> Iterator[Callable[[int, int], None]]:
    """Yield a callback (completed, total); the bar appears with the first call and disappears at the end."""
    bar: Any = None
    task: Any = None
    printed = -1

    def on_terminal(completed: int, total: int) -> None:
        nonlocal bar, task
        if bar is None:
            from rich.console import Console
            from rich.progress import Progress

            bar = Progress(console=Console(stderr=True), transient=True)
            bar.start()
            task = bar.add_task(title, total=total)
        bar.update(task, completed=completed, total=total)
        if completed >= total:
            bar.stop()

    def plain(completed: int, total: int) -> None:
        nonlocal printed
        tenth = 10 * completed // max(1, total)
        if tenth > printed:
            printed = tenth
            sys.stderr.write(f"{title}: {completed} of {total}\n")
            sys.stderr.flush()

    try:
        yield on_terminal if sys.stderr.isatty() else plain
    finally:
        if bar is not None:
            bar.stop()
