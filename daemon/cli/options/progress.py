"""A progress bar on a terminal, plain lines elsewhere; nothing at all where there is nothing to wait for."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def rendering(what: str = "Rendering the simulated rig") -> Iterator[Callable[[int, int], None]]:
    """A callback (done, of); the bar appears with the first call and goes when all is done."""
    bar: Any = None
    task: Any = None
    said = -1

    def on_terminal(done: int, of: int) -> None:
        nonlocal bar, task
        if bar is None:
            from rich.console import Console
            from rich.progress import Progress

            bar = Progress(console=Console(stderr=True), transient=True)
            bar.start()
            task = bar.add_task(what, total=of)
        bar.update(task, completed=done, total=of)
        if done >= of:
            bar.stop()

    def plain(done: int, of: int) -> None:
        nonlocal said
        tenth = 10 * done // max(1, of)
        if tenth > said:
            said = tenth
            sys.stderr.write(f"{what}: {done} of {of}\n")
            sys.stderr.flush()

    try:
        yield on_terminal if sys.stderr.isatty() else plain
    finally:
        if bar is not None:
            bar.stop()
