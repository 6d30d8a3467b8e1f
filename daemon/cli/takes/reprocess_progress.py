"""Progress of a reprocessing: bar, rate and remaining time on a terminal, a line every ten seconds otherwise."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from daemon.apps.reprocess.report.totals import Totals

_LINE_S = 10.0


@contextmanager
def shown() -> Iterator[Callable[[Totals], None]]:
    """Yield a function that shows the totals."""
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )  # fmt: skip
    start_s = time.monotonic()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task: Any = bar.add_task("Reprocessing", total=None, rate="")

        def show(totals: Totals) -> None:
            rate = totals.computed / max(1e-3, time.monotonic() - start_s)
            bar.update(
                task, completed=totals.done, total=totals.items or None, rate=f"{rate:.1f} pairs/s",
                description=f"Reprocessing, {len(totals.closed)} of {totals.recordings} recordings",
            )  # fmt: skip

        yield show


def _lines() -> Callable[[Totals], None]:
    start_s = last_s = time.monotonic()

    def show(totals: Totals) -> None:
        nonlocal last_s
        now_s = time.monotonic()
        if now_s - last_s < _LINE_S:
            return
        last_s = now_s
        rate = totals.computed / (now_s - start_s)
        left = f", {(totals.items - totals.done) / rate:.0f} s left of these" if rate > 0 else ""
        sys.stderr.write(
            f"{totals.done} of {totals.items} pairs, {len(totals.closed)} of {totals.recordings} recordings, "
            f"{rate:.1f} pairs/s{left}\n"
        )
        sys.stderr.flush()

    return show
