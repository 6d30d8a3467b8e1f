"""Worker processes for a running scheduler, one task thread each, on this machine."""

from __future__ import annotations

import asyncio
import signal
from collections.abc import Callable, Mapping
from typing import Any

from daemon.apps.reprocess.engine.dask_engine import MISSING
from daemon.common.errors import DaemonError

CONNECT_S = 30


def run_workers(
    scheduler: str,
    workers: int,
    environment: Mapping[str, str],
    *,
    memory_limit: str = "auto",
    started: Callable[[list[str]], None] = lambda _: None,
) -> None:
    """Run worker processes until the scheduler ends or a signal comes.

    Args:
        environment: of the processes, in force before they import anything.
        memory_limit: of each: data is spilled from 60 % of it, no task begins from 80 %, the process is ended and
            started again at 95 % (Dask's ``distributed.worker.memory``).
        started: called once with the workers' addresses.

    Raises:
        DaemonError: no scheduler answers, or the extra is not installed.
    """
    try:
        import dask
        from distributed import Nanny
    except ModuleNotFoundError as error:
        raise DaemonError(MISSING.format(name=error.name)) from error
    limit = _share(workers) if memory_limit == "auto" else memory_limit
    with dask.config.set({"distributed.nanny.pre-spawn-environ": dict(environment)}):
        try:
            asyncio.run(_serve(Nanny, scheduler, workers, limit, started))
        except (OSError, TimeoutError, ValueError) as error:
            raise DaemonError(f"{scheduler}: no Dask scheduler answers there: {error}") from error


async def _serve(
    nanny: Any, scheduler: str, workers: int, memory_limit: Any, started: Callable[[list[str]], None]
) -> None:
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    nannies = [nanny(scheduler, nthreads=1, memory_limit=memory_limit, death_timeout=CONNECT_S) for _ in range(workers)]
    try:
        await asyncio.wait_for(asyncio.gather(*nannies), CONNECT_S)
        started([str(one.worker_address) for one in nannies])
        ends = [asyncio.create_task(one.finished()) for one in nannies]
        ends.append(asyncio.create_task(stop.wait()))
        await asyncio.wait(ends, return_when=asyncio.FIRST_COMPLETED)
        for end in ends:
            end.cancel()
    finally:
        await asyncio.gather(*(one.close() for one in nannies), return_exceptions=True)


def _share(workers: int) -> int:
    """An equal share of the machine's memory, bytes."""
    from distributed.system import MEMORY_LIMIT

    return int(MEMORY_LIMIT // workers)
