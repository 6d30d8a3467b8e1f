"""A run: recordings are planned, their chunks computed and resumed, their summaries written; few tasks wait at once."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

from daemon.apps.reprocess.carried_state import CarriedState
from daemon.apps.reprocess.destination.results import TakeResults
from daemon.apps.reprocess.engine.tasks import Completed, Engine
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location
from daemon.apps.reprocess.plan.recordings import Recording
from daemon.apps.reprocess.plan.take_heads import Place
from daemon.apps.reprocess.report.totals import TakeTotals, Totals
from daemon.apps.reprocess.take_progress import TakeProgress
from daemon.apps.reprocess.work.chunk_work import ChunkOutcome, ChunkTask, process_chunk
from daemon.apps.reprocess.work.take_work import Planned, finish_recording, forget_summary, prepare_recording

TASKS_PER_SLOT = 3
"""Tasks that are handed over for each slot: one runs, the others wait at the worker, so that it never does."""
ATTEMPTS = 6
RETRY_S = (1.0, 2.0, 4.0, 8.0, 16.0)
"""Pauses between attempts of what may succeed later, such as a store that answers errors."""
_WAIT_S = 0.5

Label = tuple[str, str, int]
"""Kind of task, name of the recording, number of the chunk."""


@dataclass(slots=True)
class _Take:
    """A recording in work."""

    recording: Recording
    totals: TakeTotals
    excluded: set[Place] = field(default_factory=set)
    planned: Planned = field(default_factory=Planned)
    progress: TakeProgress = field(default_factory=lambda: TakeProgress(0))
    damaged: set[Place] = field(default_factory=set)
    running: int = 0
    rows: list[int] = field(default_factory=list)


class Run:
    """The reprocessing of some recordings into one destination, which the caller has locked.

    Args:
        job: what is done; root: the destination; engine: where.
        retry_failed: do what failed in an earlier run again.
        observe: called with the totals after every task.
        clock: time in seconds.

    ``totals`` and ``seconds`` are those of the run so far.
    """

    def __init__(
        self,
        job: Job,
        root: Path,
        engine: Engine,
        *,
        retry_failed: bool = False,
        observe: Callable[[Totals], None] = lambda _: None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._job, self._root, self._engine = job, root, engine
        self._retry_failed, self._observe, self._clock = retry_failed, observe, clock
        self._takes: dict[str, _Take] = {}
        self._waiting: deque[Recording] = deque()
        self._in_flight = 0
        self._attempts: dict[Label, int] = {}
        self._later: list[tuple[float, Label]] = []
        self.totals, self.seconds = Totals(), 0.0

    def run(self, recordings: Iterable[Recording]) -> Totals:
        """Do all of it.

        Raises:
            EngineLostError: the cluster is gone; what is finished stays.
        """
        start_s = self._clock()
        self._waiting.extend(recordings)
        self.totals.recordings = len(self._waiting)
        while self._waiting or self._takes:
            self._fill()
            pause = _WAIT_S if not self._later else max(0.0, min(_WAIT_S, self._later[0][0] - self._clock()))
            for completed in self._engine.wait(pause):
                self._in_flight -= 1
                self._ended(completed)
            if not self._in_flight and self._later:
                time.sleep(max(0.0, self._later[0][0] - self._clock()))
            self.seconds = self._clock() - start_s
            self._observe(self.totals)
        return self.totals

    def _fill(self) -> None:
        """Hand over tasks: those to be repeated, chunks of recordings in work, then plans of further recordings."""
        room = TASKS_PER_SLOT * self._engine.slots - self._in_flight
        while self._later and self._later[0][0] <= self._clock():
            _, label = self._later.pop(0)
            self._again(label)
            room -= 1
        for take in list(self._takes.values()):
            for number, before in take.progress.ready() if not take.damaged else ():
                if room <= 0:
                    return
                self._submit_chunk(take, number, before)
                room -= 1
        while room > 0 and self._waiting:
            recording = self._waiting.popleft()
            self._takes[recording.name] = _Take(recording, TakeTotals(recording.name, recording.url))
            self._submit_plan(self._takes[recording.name])
            room -= 1

    def _submit(self, label: Label, function: Callable[..., Any], *arguments: Any) -> None:
        self._in_flight += 1
        self._engine.submit(label, function, *arguments)

    def _submit_plan(self, take: _Take) -> None:
        label = "plan", take.recording.name, 0
        self._submit(label, prepare_recording, self._job, take.recording.url, self._folder(take), sorted(take.excluded))

    def _submit_chunk(self, take: _Take, number: int, before: Any) -> None:
        assert take.planned.plan is not None  # noqa: S101 - chunks come from a plan
        take.progress.started(number)
        take.running += 1
        task = ChunkTask(
            self._job, take.planned.plan.chunks[number], take.planned.keys[number], take.recording.url,
            self._folder(take), before, take.rows[number], take.planned.plan.bytes,
        )  # fmt: skip
        self._submit(("chunk", take.recording.name, number), _process, task)

    def _again(self, label: Label) -> None:
        take = self._takes[label[1]]
        if label[0] == "plan":
            self._submit_plan(take)
        elif label[0] == "summary":
            self._submit_summary(take)
        else:
            take.progress.reopened(label[2])
            self._check_end(take)

    def _ended(self, completed: Completed) -> None:
        label: Label = completed.label
        take = self._takes[label[1]]
        if label[0] == "plan":
            self._plan_ended(take, completed)
        elif label[0] == "chunk":
            self._chunk_ended(take, label[2], completed)
        else:
            if reason := completed.error or completed.value:
                if self._repeat(label):
                    return
                take.totals.failures.append(f"summary: {reason}")
            self._close(take)

    def _plan_ended(self, take: _Take, completed: Completed) -> None:
        planned: Planned = completed.value or Planned(error=completed.error)
        if planned.plan is None:
            if planned.transient and self._repeat(("plan", take.recording.name, 0)):
                return
            take.totals.failures.append(planned.error)
            self._close(take)
            return
        plan = planned.plan
        take.planned, take.progress = planned, TakeProgress(len(plan.chunks))
        take.totals.begin(plan)
        take.rows = list(accumulate((len(chunk.items) for chunk in plan.chunks), initial=0))
        for number, (before, outcome) in planned.done.items():
            take.progress.done(number, before, outcome.after)
            take.totals.add(number, outcome, len(plan.chunks[number].items), resumed=True)
        for number, reason in planned.failed.items():
            if not self._retry_failed:
                take.progress.failed(number, reason)
        self.totals.planned(take.totals)
        self._check_end(take)

    def _chunk_ended(self, take: _Take, number: int, completed: Completed) -> None:
        plan = take.planned.plan
        assert plan is not None  # noqa: S101 - chunks come from a plan
        take.running -= 1
        before, outcome = completed.value or (CarriedState(), ChunkOutcome(error=completed.error))
        if outcome.damaged:
            take.damaged.update(outcome.damaged)
        elif outcome.error:
            if not (outcome.transient and self._repeat(("chunk", take.recording.name, number))):
                results = TakeResults(location(self._folder(take)))
                _ignoring_errors(results.fail, plan.chunks[number].name, take.planned.keys[number], outcome.error)
                take.progress.failed(number, outcome.error)
        else:
            take.progress.done(number, before, outcome.after)
            take.totals.add(number, outcome, len(plan.chunks[number].items))
            self.totals.advanced(len(plan.chunks[number].items))
        self._check_end(take)

    def _check_end(self, take: _Take) -> None:
        """Plan again without damaged frames, finish the recording, or go on."""
        plan = take.planned.plan
        if plan is None or take.running or self._has_later(take):
            return
        if take.damaged:
            take.excluded |= take.damaged
            take.damaged = set()
            self.totals.forget(take.totals)
            take.totals = TakeTotals(take.recording.name, take.recording.url)
            take.planned, take.progress = Planned(), TakeProgress(0)
            self._submit_plan(take)
        elif take.progress.complete:
            for number, reason in take.progress.failures.items():
                chunk = plan.chunks[number].items
                take.totals.failures.append(f"pairs {chunk[0].sequence} to {chunk[-1].sequence}: {reason}")
            if take.progress.failures:
                forget_summary(self._folder(take))
                self._close(take)
            else:
                self._submit_summary(take)

    def _submit_summary(self, take: _Take) -> None:
        arguments = self._job, take.recording.url, self._folder(take), take.planned.plan
        self._submit(("summary", take.recording.name, 0), finish_recording, *arguments)

    def _close(self, take: _Take) -> None:
        del self._takes[take.recording.name]
        self.totals.close(take.totals)

    def _repeat(self, label: Label) -> bool:
        """Put a task off; False once it was tried often enough."""
        attempt = self._attempts.get(label, 0) + 1
        if attempt >= ATTEMPTS:
            return False
        self._attempts[label] = attempt
        self._later.append((self._clock() + RETRY_S[attempt - 1], label))
        self._later.sort()
        return True

    def _has_later(self, take: _Take) -> bool:
        return any(label[1] == take.recording.name for _, label in self._later)

    def _folder(self, take: _Take) -> str:
        return str(self._root / take.recording.name)


def _process(task: ChunkTask) -> tuple[CarriedState, ChunkOutcome]:
    return task.before, process_chunk(task)


def _ignoring_errors(function: Callable[..., None], *arguments: Any) -> None:
    """Note a failure; where even that cannot be written, the report still has it."""
    try:
        function(*arguments)
    except Exception:
        return
