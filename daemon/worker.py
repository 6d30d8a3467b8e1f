"""The pipeline's thread: the freshest pair in, a cloud out to every sink."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from typing import Any, Protocol

from daemon.counters import Counters, Percentiles, Rate
from daemon.errors import DaemonError
from daemon.mailbox import Mailbox
from daemon.pairing import Pair
from daemon.sinks import CloudItem
from drivers.protocols import Clock
from pipeline.cloud import Cloud
from pipeline.errors import PipelineError

log = logging.getLogger("fringed.pipeline")


class Reconstructs(Protocol):
    """What the worker needs of a reconstructor."""

    def reconstruct(self, left: Any, right: Any) -> Cloud:
        """The cloud of two raw pictures."""


class Worker:
    """Reconstructs pairs, one at a time; what cannot wait is dropped and counted.

    Args:
        queue: pairs that wait; a further one pushes the oldest out.
        emit: takes each cloud; must be quick.
        drops: counts by reason.
    """

    def __init__(self, queue: int, *, emit: Callable[[CloudItem], None], drops: Counters, clock: Clock) -> None:
        self._box: Mailbox[Pair] = Mailbox(queue)
        self._emit, self._drops, self._clock = emit, drops, clock
        self._reconstructor: Reconstructs | None = None
        self._thread = threading.Thread(target=self._run, name="pipeline", daemon=True)
        self._stop = threading.Event()
        self.clouds, self.dropped, self.points, self.valid = 0, 0, 0, 0.0
        self.rate, self.latency_ms = Rate(), Percentiles()
        self.stages_ms: dict[str, float] = {}
        self.last: CloudItem | None = None
        self._changes: deque[tuple[Callable[[], Reconstructs], Future[None]]] = deque(maxlen=16)

    def start(self, reconstructor: Reconstructs) -> None:
        """Begin, with a reconstructor that is warm."""
        self._reconstructor = reconstructor
        self._thread.start()

    def replace(self, make: Callable[[], Reconstructs], timeout_s: float) -> None:
        """Make another reconstructor between two pairs and use it from then on.

        It is made in the pipeline's thread, because not every threading layer of numba bears two callers.

        Raises:
            DaemonError: when the pipeline does not get to it in time; PipelineError: from ``make``.
        """
        done: Future[None] = Future()
        self._changes.append((make, done))
        try:
            done.result(timeout_s)
        except FutureTimeoutError as error:
            done.cancel()
            raise DaemonError(f"the pipeline did not take over the change within {timeout_s:g} s") from error

    def offer(self, pair: Pair) -> None:
        """Take a pair; the freshest wins."""
        if not self._thread.is_alive():
            self._drop("pairs_not_ready")
        elif self._box.put(pair) is not None:
            self._drop("pairs_pipeline_busy")

    def _drop(self, reason: str) -> None:
        self.dropped += 1
        self._drops.add(reason)

    def stop(self, timeout_s: float) -> bool:
        """Finish the pair at hand and end; False when it does not end in time."""
        self._stop.set()
        self._drops.add("pairs_stopped", len(self._box.close()))
        if self._thread.ident is not None:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while not self._stop.is_set():
            self._change()
            pair = self._box.get(0.2)
            if pair is None:
                continue
            try:
                self._measure(pair)
            except PipelineError as error:
                self._drops.add("pairs_refused_by_pipeline")
                log.warning("pair %d cannot be measured: %s", pair.seq, error)
            except Exception:
                self._drops.add("pairs_failed_in_pipeline")
                log.exception("pair %d failed", pair.seq)

    def _change(self) -> None:
        while self._changes:
            make, done = self._changes.popleft()
            if not done.set_running_or_notify_cancel():
                continue
            try:
                self._reconstructor = make()
                done.set_result(None)
            except Exception as error:
                done.set_exception(error)

    def _measure(self, pair: Pair) -> None:
        assert self._reconstructor is not None  # noqa: S101 - start() has set it
        cloud = self._reconstructor.reconstruct(pair.left.image, pair.right.image)
        # The latency is taken here, where the result is made, not where it is written or shown.
        latency_ms = (self._clock.realtime_ns() - pair.left.t_exposure_ns) / 1e6
        item = CloudItem(pair.seq, pair.left.t_exposure_ns, cloud, pair.left, pair.right, latency_ms, self.dropped)
        self.latency_ms.note(latency_ms)
        self.rate.note(self._clock.monotonic_ns())
        self.clouds += 1
        self.points = cloud.points
        self.valid = self.points / max(1, cloud.gray.size)
        self.stages_ms = {name: round(ms, 2) for name, ms in cloud.ms.items()}
        self.last = item
        self._emit(item)
