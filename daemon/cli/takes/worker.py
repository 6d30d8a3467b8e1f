"""``fringed worker``: processes that compute for a Dask scheduler."""

from __future__ import annotations

import os
from typing import Annotated

import typer


def main(
    scheduler: Annotated[str, typer.Argument(help="Address of the scheduler, tcp://HOST:8786.")],
    workers: Annotated[int, typer.Option(min=0, max=1024, help="Processes; 0 = one for each processor.")] = 0,
    threads: Annotated[int, typer.Option(min=1, max=256, help="Threads of numba in each process.")] = 1,
    memory_limit: Annotated[
        str, typer.Option(help="Memory of each process, such as 4GiB; auto = an equal share of the machine's.")
    ] = "auto",
) -> None:
    """Start worker processes for `fringed reprocess --scheduler`, and run until the scheduler ends.

    Each process does one task at a time. From 60 % of its memory limit it moves data to the disk, from 80 % it begins
    no task, at 95 % it is ended and started again.
    """
    from daemon.apps.reprocess.engine.worker_processes import run_workers
    from daemon.cli.allocator import worker_environment
    from daemon.kernels import release

    count = workers or max(1, len(os.sched_getaffinity(0)) // threads)

    def started(addresses: list[str]) -> None:
        typer.echo(f"{len(addresses)} worker processes of {threads} threads work for {scheduler}", err=True)

    release.unpack()
    run_workers(scheduler, count, worker_environment(threads), memory_limit=memory_limit, started=started)
