"""The processors that are reserved for the pipeline."""

from __future__ import annotations

from collections.abc import Iterable

from daemon.common import threads
from daemon.common.errors import DaemonError


def reserve_cpus(cpus: Iterable[int]) -> frozenset[int]:
    """Keep all threads of this process off these processors, as far as there are others.

    Returns:
        The processors that the threads used before; empty where nothing was changed.
    """
    reserved, available = frozenset(cpus), threads.available()
    missing = sorted(reserved - available)
    if missing:
        raise DaemonError(f"pipeline.cpus: {missing} cannot be used, there are {sorted(available)}")
    if not reserved or not available - reserved:
        return frozenset()
    threads.pin(threads.ids(), available - reserved)
    return available
