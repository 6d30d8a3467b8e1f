"""The pipeline's thread: the newest pair or image set in, a cloud out."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Collection
from concurrent.futures import FIRST_COMPLETED, Future, wait

from daemon.common import threads
from daemon.common.counters import Counters, Percentiles, Rate
from daemon.common.errors import DaemonError
from daemon.common.heartbeat import Heartbeat
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import Pipeline
from daemon.live.items import SINGLE, CloudItem, ImageSet, Pair
from daemon.live.processing.calibration_verdicts import CalibrationVerdicts
from daemon.live.processing.cloud_reconstructor import CloudReconstructor
from daemon.live.processing.gc_control import GcControl, GcPauses
from daemon.live.processing.load_shedding import LoadShedding
from daemon.live.processing.page_faults import PageFaults
from daemon.live.processing.slowest_pair import SlowestPair
from daemon.live.processing.temporal_prior import TemporalPrior
from drivers.protocols import Clock
from pipeline.common.errors import PipelineError
from pipeline.reconstruct.optional_parts import with_parts

log = logging.getLogger("fringed.pipeline")

_IDLE_S = 0.2
_TURN_S, _MEASURE_S, _MAKE_S = 10.0, 30.0, 900.0  # longest times of a turn; compiling takes minutes


Make = Callable[[], CloudReconstructor | None]


class Worker:
    """Reconstructs pairs or sets, one at a time; what cannot wait is dropped and counted.

    Args:
        config: of the pipeline.
        emit: takes each cloud; must be quick.
        drops: counts by reason.
        wanted: the optional parts that the next cloud needs; called once for each.
    """

    def __init__(
        self,
        config: Pipeline,
        *,
        emit: Callable[[CloudItem], None],
        drops: Counters,
        clock: Clock,
        wanted: Callable[[], Collection[str]] = frozenset,
    ) -> None:
        self._queue: LatestWinsQueue[Pair | ImageSet] = LatestWinsQueue(config.queue)
        self._config, self._emit, self._drops, self._clock = config, emit, drops, clock
        self._wanted = wanted
        self._reconstructor: CloudReconstructor | None = None
        self._thread = threading.Thread(target=self._run, name="pipeline", daemon=True)
        self._stop = threading.Event()
        self.clouds, self.dropped, self.points, self.valid = 0, 0, 0, 0.0
        self.verdicts = CalibrationVerdicts()
        self.finished, self.heartbeat = 0, Heartbeat(clock.monotonic_ns)
        self.rate, self.latency_ms = Rate(), Percentiles()
        self.stages_ms: dict[str, float] = {}
        self.last: CloudItem | None = None
        self._load = LoadShedding(enabled=config.overload == "half")
        self._prior = TemporalPrior()
        self._gc, self.gc_pauses = GcControl(), GcPauses()
        self.page_faults, self.slowest = PageFaults(), SlowestPair()
        self._changes: deque[tuple[Make, Future[None]]] = deque(maxlen=16)
        self._made: Future[None] = Future()
        self._ended: Future[None] = Future()

    @property
    def stride(self) -> int:
        """Spacing of the pixels that are measured now: 2 while the pipeline is overloaded and may skip pixels."""
        return self._load.stride

    @property
    def waiting(self) -> int:
        """Pairs that wait to be measured."""
        return len(self._queue)

    def start(self, make: Make) -> Future[None]:
        """Make a reconstructor, every kernel compiled, and measure from then on.

        All of that happens in the pipeline's thread, so that numba's workers belong to it alone.

        Returns:
            Done when it is made; holds the exception when it could not be.
        """
        self._make = make
        self._thread.start()
        return self._made

    def replace(self, make: Make, timeout_s: float) -> None:
        """Make another reconstructor between two pairs and use it from then on; None: keep the present one.

        It is made in the pipeline's thread, because not every threading layer of numba supports two callers. ``make``
        may change what else must change between two pairs, as its last act.

        Raises:
            DaemonError: when the pipeline does not get to it in time, or ends; PipelineError: from ``make``.
        """
        done: Future[None] = Future()
        self._changes.append((make, done))
        wait((done, self._ended), timeout_s, FIRST_COMPLETED)
        if done.done():
            done.result()
        elif not done.cancel() and not self._ended.done():
            raise DaemonError(
                f"the change is still being made after {timeout_s:g} s; check later whether it was applied"
            )
        elif self._ended.done():
            raise DaemonError("the daemon is stopping; nothing was changed")
        else:
            raise DaemonError(f"the pipeline did not apply the change within {timeout_s:g} s; nothing was changed")

    def end_changes(self) -> None:
        """Reject changes from now on, those that wait at once."""
        if not self._ended.done():
            self._ended.set_result(None)

    def configure(self, config: Pipeline) -> None:
        """Set overload and temporal prior from now on; to be called between two pairs."""
        self._config = config
        self._load.enable(config.overload == "half")

    def offer(self, captured: Pair | ImageSet) -> None:
        """Take a pair or a set; the newest wins."""
        if not self._running():
            self._drop(captured, "not_ready")
            return
        now_ns = self._clock.monotonic_ns()
        if isinstance(captured, Pair):
            self._load.offered(now_ns)
        pushed_out = self._queue.put(captured)
        if pushed_out is not None:
            if isinstance(pushed_out, Pair):
                self._load.dropped(now_ns)
            self._drop(pushed_out, "pipeline_busy")

    def _running(self) -> bool:
        return self._reconstructor is not None and self._thread.is_alive()

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a user should correct at the cameras, as far as pairs have shown it."""
        reconstructor = self._reconstructor
        return () if reconstructor is None else reconstructor.warnings

    def _drop(self, captured: Pair | ImageSet, reason: str) -> None:
        self.dropped += 1
        self._count(captured, reason)

    def _count(self, captured: Pair | ImageSet, reason: str) -> None:
        self._drops.add(f"{captured.noun}s_{reason}")

    def stop(self, timeout_s: float) -> bool:
        """Finish the current pair and end; False when it does not end in time.

        Compiling, up to a minute after an update, is not waited for: the end of the program ends it.
        """
        self._stop.set()
        self.end_changes()
        for captured in self._queue.close():
            self._count(captured, "stopped")
        if not self._running():
            return True
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            threads.name(threading.get_native_id(), self._thread.name)
            if self._config.cpus:
                threads.pin([threading.get_native_id()], self._config.cpus)
            self.heartbeat.expect(_MAKE_S)
            self._reconstructor = self._make()
        except Exception as error:
            self.heartbeat.rest()
            self._made.set_exception(error)
            return
        self._made.set_result(None)
        try:
            self._freeze()
            self.gc_pauses.start()
            self.page_faults.start()
            while not self._stop.is_set():
                self._next()
        finally:
            self.heartbeat.rest()
            self.gc_pauses.stop()
            self._gc.release()

    def _next(self) -> None:
        self._change()
        self.heartbeat.expect(_TURN_S)
        captured = self._queue.get(_IDLE_S)
        if captured is not None:
            self.heartbeat.expect(_MEASURE_S)
            with self.page_faults.pair():
                self._try(captured)
            self.finished += 1
            self.heartbeat.expect(_TURN_S)
        self._gc.between_pairs(self._clock.monotonic_ns() / 1e9, idle=not self._queue)

    def _freeze(self) -> None:
        self._gc.take_over(self._clock.monotonic_ns() / 1e9)

    def _change(self) -> None:
        while self._changes:
            make, done = self._changes.popleft()
            if not done.set_running_or_notify_cancel():
                continue
            self.heartbeat.expect(_MAKE_S)
            try:
                reconstructor = make()
                if reconstructor is not None:
                    self._reconstructor = reconstructor
                    self._prior.reset()
                    self._freeze()  # the reconstructor that was frozen before can be freed
                done.set_result(None)
            except Exception as error:
                done.set_exception(error)

    def _try(self, captured: Pair | ImageSet) -> None:
        reconstructor = self._reconstructor
        if reconstructor is None or reconstructor.mode != captured.mode:
            self._drop(captured, "of_another_mode")
            return
        try:
            self._measure(captured, reconstructor)
        except PipelineError as error:
            self._prior.reset()
            self._count(captured, "refused_by_pipeline")
            log.warning("%s %d cannot be measured: %s", captured.noun, captured.seq, error)
        except Exception:
            self._prior.reset()
            self._count(captured, "failed_in_pipeline")
            log.exception("%s %d failed", captured.noun, captured.seq)

    def _measure(self, captured: Pair | ImageSet, reconstructor: CloudReconstructor) -> None:
        """Sets are measured in full, however long it takes, and without a prior: their scene is at rest."""
        single, seq, t_ns = captured.mode == SINGLE, captured.seq, captured.t_ns
        stride = self._load.stride if single else 1
        use_prior = single and self._config.temporal_prior and self._prior.usable(seq, t_ns, stride)
        began_ns, began_at_ns = self._clock.monotonic_ns(), self._clock.realtime_ns()
        left, right = captured.images
        cloud = reconstructor.reconstruct(left, right, stride=stride, use_prior=use_prior)
        if wanted := self._wanted():
            cloud = with_parts(cloud, reconstructor, left, wanted, stride=stride, clock=self._clock.monotonic_ns)
        # The latency is taken here, where the result is made, not where it is written or shown.
        latency_ms = (self._clock.realtime_ns() - t_ns) / 1e6
        item = CloudItem(
            seq, t_ns, cloud, captured.left, captured.right, latency_ms, self.dropped, stride,
            captured.mode, captured.frames, captured.span_ms,
        )  # fmt: skip
        now_ns = self._clock.monotonic_ns()
        self._note(item, now_ns)
        self.slowest.note(item, began_at_ns, now_ns)
        self.verdicts.note(cloud.consistency, self._config.calibration_check)
        self._emit(item)
        self._prior.measured(seq, t_ns, stride)
        if single and self._load.measured((now_ns - began_ns) / 1e6, stride, now_ns):
            log.info("load: every %s pixel is measured", "second" if self._load.stride == 2 else "single")

    def _note(self, item: CloudItem, now_ns: int) -> None:
        self.latency_ms.note(item.latency_ms)
        self.rate.note(now_ns)
        self.clouds += 1
        self.points = item.cloud.points
        self.valid = self.points / max(1, item.cloud.gray.size)
        self.stages_ms = {name: round(ms, 2) for name, ms in item.cloud.ms.items()}
        self.last = item
