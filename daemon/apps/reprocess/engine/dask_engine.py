"""Tasks on a Dask cluster: one on this machine, or a running one by the address of its scheduler."""

from __future__ import annotations

import logging
import queue
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError
from contextlib import ExitStack, contextmanager
from typing import Any

from daemon.apps.reprocess.engine.tasks import Completed, EngineLostError
from daemon.common.errors import DaemonError

MISSING = (
    "reprocessing on a cluster needs the packages of the extra cluster ({name} is missing): pip install "
    "'fringed-rig[cluster]'; --workers 0 works without them, in this process"
)
_CONNECT_S = 20
_PROBE_S = 2.5
"""Dask repeats a refused connection until its time is up."""
_COUNT_S = 5.0
_LOST = "the scheduler is gone, or dropped the tasks; finished results are kept: run the same command again"
_MEMORY_TOPIC = "worker-restart-memory"


class DaskEngine:
    """Runs tasks on the workers of a client's cluster.

    Args:
        client: connected, of the package ``distributed``.
    """

    def __init__(self, client: Any) -> None:
        self._client = client
        self._ended: queue.SimpleQueue[tuple[Any, Any]] = queue.SimpleQueue()
        self._out_of_memory: dict[str, str] = {}
        self._pending: set[Any] = set()
        self._slots, self._counted_s = 1, float("-inf")
        client.subscribe_topic(_MEMORY_TOPIC, self._remember_memory)

    @property
    def slots(self) -> int:
        """Task threads of all workers, at least one; asked for every few seconds, for workers come and go."""
        now_s = time.monotonic()
        if now_s - self._counted_s > _COUNT_S:
            with self._scheduler():
                self._slots, self._counted_s = max(1, int(sum(self._client.nthreads().values()))), now_s
        return self._slots

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's page."""
        return str(self._client.dashboard_link)

    def submit(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Send a call to the scheduler."""
        with self._scheduler():
            future = self._client.submit(function, *arguments, pure=False)
        self._pending.add(future)
        future.add_done_callback(lambda ended: self._ended.put((label, ended)))

    def wait(self, timeout_s: float) -> list[Completed]:
        """Wait until a task ends; EngineLostError once the scheduler is gone."""
        try:
            ended = [self._ended.get(timeout=timeout_s)]
        except queue.Empty:
            self._check()
            return []
        while not self._ended.empty():
            ended.append(self._ended.get())
        return [self._completed(label, future) for label, future in ended]

    def _completed(self, label: Any, future: Any) -> Completed:
        self._pending.discard(future)
        with self._scheduler():
            if future.status == "finished":
                return Completed(label, future.result())
            if future.status == "error":
                return Completed(label, error=self._explain(future.exception()))
        raise EngineLostError(_LOST)

    def _check(self) -> None:
        if self._client.status != "running":
            raise EngineLostError(_LOST)

    @contextmanager
    def _scheduler(self) -> Iterator[None]:
        """Around calls that fail when the scheduler is gone."""
        try:
            yield
        except (OSError, RuntimeError, CancelledError) as error:
            raise EngineLostError(_LOST) from error

    def _explain(self, error: BaseException) -> str:
        """The reason of a task that gave no value; a killed worker's with what is known of its end."""
        from distributed.scheduler import KilledWorker

        if not isinstance(error, KilledWorker):
            return f"{type(error).__name__}: {error}"
        last, times = error.last_worker.address, error.allowed_failures + 1
        memory = self._out_of_memory.get(last)
        if memory:
            return (
                f"{times} worker processes that did it were ended for lack of memory (the last one, {last}, {memory}); "
                "give workers more memory (--memory-limit) or start fewer, or make --chunk smaller"
            )
        return (
            f"{times} worker processes died doing it (the last one was {last}); none reported that it reached its "
            "memory limit: the system's out-of-memory killer (see dmesg), a crash, or a node that went away"
        )

    def _remember_memory(self, event: tuple[Any, Mapping[str, Any]]) -> None:
        _, values = event
        used, worker = values.get("rss"), str(values.get("worker"))
        self._out_of_memory[worker] = f"at {used / 2**20:.0f} MiB" if isinstance(used, int | float) else "at its limit"


@contextmanager
def connected(scheduler: str) -> Iterator[DaskEngine]:
    """The engine of a running cluster.

    Raises:
        DaemonError: no scheduler answers, or the extra is not installed.
    """
    with _packages():
        from distributed import Client
        from distributed.comm.addressing import get_address_host_port
    try:
        if scheduler.startswith(("tcp://", "tls://")):
            socket.create_connection(get_address_host_port(scheduler, strict=True), _PROBE_S).close()
        client = Client(scheduler, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise DaemonError(f"--scheduler {scheduler}: no Dask scheduler answers there: {error}") from error
    with client:
        yield DaskEngine(client)


@contextmanager
def local_cluster(
    workers: int, environment: Mapping[str, str], *, memory_limit: str = "auto", port: int = 0
) -> Iterator[DaskEngine]:
    """The engine of a cluster of worker processes on this machine, each with one task thread.

    Args:
        environment: variables of the workers, in force before they import anything.
        memory_limit: of each worker, such as ``4GiB``; auto = an equal share of the machine's memory.
        port: of the dashboard, 0 = any free one.
    """
    with _packages():
        import dask
        from distributed import Client, LocalCluster
    with ExitStack() as stack:
        stack.enter_context(dask.config.set({"distributed.nanny.pre-spawn-environ": dict(environment)}))
        cluster = stack.enter_context(
            LocalCluster(
                n_workers=workers, threads_per_worker=1, processes=True, memory_limit=memory_limit,
                dashboard_address=f"127.0.0.1:{port}", silence_logs=logging.ERROR,
            )
        )  # fmt: skip
        yield DaskEngine(stack.enter_context(Client(cluster, set_as_default=False)))


@contextmanager
def _packages() -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        raise DaemonError(MISSING.format(name=error.name)) from error
