"""The pipeline's thread: the freshest pair in, a cloud out to every sink."""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, wait
from typing import Any, Protocol

from daemon.common import threads
from daemon.common.counters import Counters, Percentiles, Rate
from daemon.common.errors import DaemonError
from daemon.common.heartbeat import Heartbeat
from daemon.common.latest_wins_queue import LatestWinsQueue
from daemon.config.rig_config import Pipeline
from daemon.live.acquisition.pairer import Pair
from daemon.live.items import CloudItem
from daemon.live.processing.gc_control import GcControl, GcPauses
from daemon.live.processing.load_shedding import LoadShedding
from daemon.live.processing.temporal_prior import TemporalPrior
from daemon.live.sets import SINGLE, ImageSet
from drivers.protocols import Clock
from pipeline.common.errors import PipelineError
from pipeline.reconstruct.cloud import Cloud

log = logging.getLogger("fringed.pipeline")

_IDLE_S = 0.2
_TURN_S, _MEASURE_S, _MAKE_S = 10.0, 30.0, 900.0  # longest times of a turn; compiling takes minutes


class Reconstructs(Protocol):
    """What the worker needs of a reconstructor."""

    def reconstruct(self, left: Any, right: Any, *, stride: int = 1, use_prior: bool = False) -> Cloud:
        """The cloud of two raw images.

        Args:
            stride: spacing of the pixels that are measured, 1 or 2; use_prior: the last pair's surface is a good guess.
        """


class ReconstructsSets(Protocol):
    """What the worker needs of a reconstructor of sets."""

    mode: str

    def warm_up(self) -> None:
        """Compile every kernel."""

    def reconstruct(self, lefts: Any, rights: Any) -> Cloud:
        """The cloud of the raw images of a set, in the order of its sequence."""


Make = Callable[[], Reconstructs | ReconstructsSets | None]
Shot = Pair | ImageSet


class Worker:
    """Reconstructs pairs or sets, one at a time; what cannot wait is dropped and counted.

    Args:
        config: of the pipeline.
        emit: takes each cloud; must be quick.
        drops: counts by reason.
    """

    def __init__(self, config: Pipeline, *, emit: Callable[[CloudItem], None], drops: Counters, clock: Clock) -> None:
        self._box: LatestWinsQueue[Shot] = LatestWinsQueue(config.queue)
        self._config, self._emit, self._drops, self._clock = config, emit, drops, clock
        self._reconstructor: Reconstructs | ReconstructsSets | None = None
        self._thread = threading.Thread(target=self._run, name="pipeline", daemon=True)
        self._stop = threading.Event()
        self.clouds, self.dropped, self.points, self.valid = 0, 0, 0, 0.0
        self.finished, self.heartbeat = 0, Heartbeat(clock.monotonic_ns)
        self.rate, self.latency_ms = Rate(), Percentiles()
        self.stages_ms: dict[str, float] = {}
        self.last: CloudItem | None = None
        self._overload = LoadShedding(enabled=config.overload == "half")
        self._sequel = TemporalPrior()
        self._garbage, self.pauses = GcControl(), GcPauses()
        self._changes: deque[tuple[Make, Future[None]]] = deque(maxlen=16)
        self._made: Future[None] = Future()
        self._ended: Future[None] = Future()

    @property
    def stride(self) -> int:
        """Spacing of the pixels that are measured now: 2 while the pipeline is overloaded and may skip pixels."""
        return self._overload.stride

    @property
    def waiting(self) -> int:
        """Pairs that wait to be measured."""
        return len(self._box)

    def start(self, make: Make) -> Future[None]:
        """Begin: make a reconstructor, every kernel compiled, and measure from then on.

        All of that happens in the pipeline's thread, so that numba's workers belong to it and to nobody else.

        Returns:
            Done when it is made; holds the exception when it could not be.
        """
        self._make = make
        self._thread.start()
        return self._made

    def replace(self, make: Make, timeout_s: float) -> None:
        """Make another reconstructor between two pairs and use it from then on; None: keep the one that is there.

        It is made in the pipeline's thread, because not every threading layer of numba bears two callers. ``make`` may
        change what else must change between two pairs, as its last act.

        Raises:
            DaemonError: when the pipeline does not get to it in time, or ends; PipelineError: from ``make``.
        """
        done: Future[None] = Future()
        self._changes.append((make, done))
        wait((done, self._ended), timeout_s, FIRST_COMPLETED)
        if done.done():
            done.result()
        elif not done.cancel() and not self._ended.done():
            raise DaemonError(f"the pipeline is still at it after {timeout_s:g} s; ask later whether the change came")
        elif self._ended.done():
            raise DaemonError("the daemon is stopping; nothing was changed")
        else:
            raise DaemonError(f"the pipeline did not take over the change within {timeout_s:g} s; nothing was changed")

    def end_changes(self) -> None:
        """Refuse changes from now on, those that wait at once."""
        if not self._ended.done():
            self._ended.set_result(None)

    def configure(self, config: Pipeline) -> None:
        """Overload and temporal prior from now on; to be called between two pairs."""
        self._config = config
        self._overload.enable(config.overload == "half")

    def offer(self, shot: Shot) -> None:
        """Take a pair or a set; the freshest wins."""
        if not self._running():
            self._drop(shot, "not_ready")
            return
        now_ns = self._clock.monotonic_ns()
        if isinstance(shot, Pair):
            self._overload.offered(now_ns)
        pushed_out = self._box.put(shot)
        if pushed_out is not None:
            if isinstance(pushed_out, Pair):
                self._overload.dropped(now_ns)
            self._drop(pushed_out, "pipeline_busy")

    def _running(self) -> bool:
        return self._reconstructor is not None and self._thread.is_alive()

    def _drop(self, shot: Shot, reason: str) -> None:
        self.dropped += 1
        self._count(shot, reason)

    def _count(self, shot: Shot, reason: str) -> None:
        self._drops.add(f"{_kind(shot)}s_{reason}")

    def stop(self, timeout_s: float) -> bool:
        """Finish the pair at hand and end; False when it does not end in time.

        Compiling, up to a minute after an update, is not waited for: the end of the program ends it.
        """
        self._stop.set()
        self.end_changes()
        for shot in self._box.close():
            self._count(shot, "stopped")
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
            self._hold_garbage()
            self.pauses.start()
            while not self._stop.is_set():
                self._next()
        finally:
            self.heartbeat.rest()
            self.pauses.stop()
            self._garbage.release()

    def _next(self) -> None:
        self._change()
        self.heartbeat.expect(_TURN_S)
        shot = self._box.get(_IDLE_S)
        if shot is not None:
            self.heartbeat.expect(_MEASURE_S)
            self._try(shot)
            self.finished += 1
            self.heartbeat.expect(_TURN_S)
        self._garbage.between_pairs(self._clock.monotonic_ns() / 1e9, idle=not self._box)

    def _hold_garbage(self) -> None:
        self._garbage.hold(self._clock.monotonic_ns() / 1e9)

    def _try(self, shot: Shot) -> None:
        try:
            if isinstance(shot, ImageSet):
                self._measure_set(shot)
            else:
                self._measure(shot)
        except PipelineError as error:
            self._sequel.forget()
            self._count(shot, "refused_by_pipeline")
            log.warning("%s %d cannot be measured: %s", _kind(shot), shot.seq, error)
        except Exception:
            self._sequel.forget()
            self._count(shot, "failed_in_pipeline")
            log.exception("%s %d failed", _kind(shot), shot.seq)

    def _change(self) -> None:
        while self._changes:
            make, done = self._changes.popleft()
            if not done.set_running_or_notify_cancel():
                continue
            self.heartbeat.expect(_MAKE_S)
            try:
                made = make()
                if made is not None:
                    self._reconstructor = made
                    self._sequel.forget()
                    self._hold_garbage()  # the reconstructor that was frozen before can go
                done.set_result(None)
            except Exception as error:
                done.set_exception(error)

    def _measure(self, pair: Pair) -> None:
        reconstructor: Any = self._reconstructor
        if getattr(reconstructor, "mode", SINGLE) != SINGLE:
            self._drop(pair, "of_another_mode")
            return
        stride, t_ns = self._overload.stride, pair.left.t_exposure_ns
        use_prior = self._config.temporal_prior and self._sequel.follows(pair.seq, t_ns, stride)
        began_ns = self._clock.monotonic_ns()
        cloud = reconstructor.reconstruct(pair.left.image, pair.right.image, stride=stride, use_prior=use_prior)
        # The latency is taken here, where the result is made, not where it is written or shown.
        latency_ms = (self._clock.realtime_ns() - t_ns) / 1e6
        item = CloudItem(pair.seq, t_ns, cloud, pair.left, pair.right, latency_ms, self.dropped, stride)
        now_ns = self._clock.monotonic_ns()
        self._note(item, now_ns)
        self._emit(item)
        self._sequel.measured(pair.seq, t_ns, stride)
        if self._overload.measured((now_ns - began_ns) / 1e6, stride, now_ns):
            log.info("load: every %s pixel is measured", "second" if self._overload.stride == 2 else "single")

    def _measure_set(self, shot: ImageSet) -> None:
        """Every pixel, however long it takes: the scene is at rest."""
        reconstructor: Any = self._reconstructor
        if getattr(reconstructor, "mode", SINGLE) != shot.mode:
            self._drop(shot, "of_another_mode")
            return
        cloud = reconstructor.reconstruct(shot.lefts, shot.rights)
        latency_ms = (self._clock.realtime_ns() - shot.t_ns) / 1e6
        item = CloudItem(
            shot.seq, shot.t_ns, cloud, shot.left, shot.right, latency_ms, self.dropped,
            mode=shot.mode, frames=len(shot.pairs), span_ms=shot.span_ms,
        )  # fmt: skip
        self._sequel.forget()
        self._note(item, self._clock.monotonic_ns())
        self._emit(item)

    def _note(self, item: CloudItem, now_ns: int) -> None:
        self.latency_ms.note(item.latency_ms)
        self.rate.note(now_ns)
        self.clouds += 1
        self.points = item.cloud.points
        self.valid = self.points / max(1, item.cloud.gray.size)
        self.stages_ms = {name: round(ms, 2) for name, ms in item.cloud.ms.items()}
        self.last = item


def _kind(shot: Shot) -> str:
    return "set" if isinstance(shot, ImageSet) else "pair"
