"""The task of a worker: reconstruct a chunk from the state before it, write its clouds, then its manifest."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
import socket
import time
from collections import OrderedDict
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from daemon.apps.export.cloud_files import SavedCloud, cloud_bytes, cloud_name
from daemon.apps.replay.reconstruct_item import (
    check_serials,
    check_size,
    problems_of,
    timed,
    warmed_reconstructor,
    with_item_parts,
)
from daemon.apps.reprocess.carried_state import CarriedState, capture, restore
from daemon.apps.reprocess.destination.cloud_store import write_row
from daemon.apps.reprocess.destination.results import ChunkManifest, TakeResults
from daemon.apps.reprocess.job import Job, release
from daemon.apps.reprocess.locations import location, remote, write_whole
from daemon.apps.reprocess.plan.chunk_plan import Chunk, PlannedItem
from daemon.apps.reprocess.plan.take_heads import Place
from daemon.apps.reprocess.work.frame_loader import DamagedFramesError, FrameLoader
from daemon.common.errors import DaemonError
from daemon.live.processing.temporal_prior import TemporalPrior
from daemon.recording.read.take_reader import TakeReader
from daemon.rig.calibration_file import CalibrationFile, parse_calibration
from pipeline.common.errors import PipelineError
from pipeline.reconstruct.cloud import Cloud

_LIT = 5.0
"""Fringe amplitude, counts, from which a pixel counts as lit in the rejected share; independent of the settings."""
_RECONSTRUCTORS = 2
_reconstructors: OrderedDict[str, tuple[Any, CarriedState]] = OrderedDict()


@dataclass(frozen=True, slots=True)
class ChunkTask:
    """One task.

    Args:
        job, chunk: what to do with what; key: of the results, see ``Job.key``.
        url: of the take; folder: of its results.
        before: the state that the items before the chunk left.
        row: of the chunk's first item among all of the take; bytes: of all files of the take.
    """

    job: Job
    chunk: Chunk
    key: str
    url: str
    folder: str
    before: CarriedState = field(default_factory=CarriedState)
    row: int = 0
    bytes: int = 0


@dataclass(slots=True)
class ChunkOutcome:
    """What the client learns: totals, and the state after the chunk.

    Args:
        error: reason of a failure, empty without; transient: another attempt may succeed.
        damaged: places of frames that must be excluded from the plan; then nothing was written.
        points, coverage, total_ms, verdicts: one value for each cloud.
    """

    after: CarriedState = field(default_factory=CarriedState)
    error: str = ""
    transient: bool = False
    damaged: list[Place] = field(default_factory=list)
    failed: int = 0
    points: list[int] = field(default_factory=list)
    coverage: list[float] = field(default_factory=list)
    rejected: list[float] = field(default_factory=list)
    total_ms: list[float] = field(default_factory=list)
    verdicts: list[str] = field(default_factory=list)
    seconds: float = 0.0

    @classmethod
    def of(cls, manifest: ChunkManifest) -> ChunkOutcome:
        """The outcome described by a manifest."""
        rows = manifest.rows
        return cls(
            manifest.after,
            failed=len(manifest.failed),
            points=[row["points"] for row in rows],
            coverage=[row["coverage"] for row in rows],
            rejected=[row["rejected"] for row in rows],
            total_ms=[row["total_ms"] for row in rows],
            verdicts=[(row["consistency"] or {}).get("verdict", "") for row in rows],
            seconds=manifest.seconds,
        )


def process_chunk(task: ChunkTask) -> ChunkOutcome:
    """Do a task; every error but the end of the process becomes part of the outcome."""
    try:
        return ChunkOutcome.of(_process(task))
    except _Damage as damage:
        return ChunkOutcome(damaged=damage.places)
    except (DaemonError, PipelineError, OSError, MemoryError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        reason = str(error) or type(error).__name__
        return ChunkOutcome(error=reason, transient=isinstance(cause, OSError) and not _lasting(cause))
    except Exception as error:
        # Libraries of object stores have errors of their own for a network that fails.
        return ChunkOutcome(error=f"{type(error).__name__}: {error}", transient=remote(task.url, task.folder))


class _Damage(Exception):
    """All damaged frames of a chunk."""

    def __init__(self, places: list[Place]) -> None:
        self.places = places


def _lasting(error: OSError) -> bool:
    """Whether another attempt would fail too: no such file, no permission, or a full disk."""
    return isinstance(error, FileNotFoundError | PermissionError | NotADirectoryError | IsADirectoryError) or (
        error.errno in (errno.ENOSPC, errno.EROFS, errno.EDQUOT)
    )


def _check_release(job: Job) -> None:
    """Refuse to mix the results of two releases in one recording."""
    here = release()
    if here != dict(job.release):
        names = [
            f"{name} {here[name]} instead of {number}" for name, number in job.release.items() if here[name] != number
        ]
        raise DaemonError(
            f"the worker on {socket.gethostname()} has {', '.join(names)}; install the same packages there, then "
            "--retry-failed"
        )


def _process(task: ChunkTask) -> ChunkManifest:
    start_s, start_cpu_s = time.perf_counter(), time.process_time()
    _check_release(task.job)
    take, job = _open_take.get(task.url, task.bytes), task.job
    loader, results = FrameLoader(take), TakeResults(location(task.folder))
    calibration = calibration_of(take, job)
    manifest = ChunkManifest(
        task.key, task.chunk.source(), calibration.identity, task.before, task.before, dict(job.release)
    )
    results.begin(task.chunk.name)
    prior, state = TemporalPrior(), task.before
    warnings: tuple[str, ...] = ()
    damaged: list[Place] = []
    for row, planned in enumerate(task.chunk.items, task.row):
        try:
            item = loader.item(planned)
        except DamagedFramesError as error:
            damaged += error.places
        if damaged:  # only search for more damage
            continue
        check_size(item, calibration.calibration)
        reconstructor, state = reconstructor_for(take, job, calibration, item.pair.encoding, state)
        use_prior = job.use_prior and prior.usable(planned.sequence, planned.t_ns, 1)
        try:
            cloud, run = timed(reconstructor, item, use_prior=use_prior)
        except PipelineError as error:
            prior.reset()
            manifest.failed.append({"sequence": planned.sequence, "error": str(error)})
            if job.kind == "zarr":
                write_row(results.folder, row, None)
            continue
        finally:
            state, warnings = capture(reconstructor), reconstructor.warnings
        prior.measured(planned.sequence, planned.t_ns, 1)
        manifest.rows.append(dataclasses.asdict(run) | shares(cloud, run.points))
        if job.kind == "zarr" or (job.kind and planned.write):
            _write(task, row, planned, with_item_parts(cloud, reconstructor, item, job.parts), results, manifest)
    if damaged:
        raise _Damage(damaged)
    manifest.after, manifest.problems = state, [*problems_of(take, calibration), *warnings]
    manifest.seconds, manifest.worker = round(time.perf_counter() - start_s, 3), f"{socket.gethostname()}:{os.getpid()}"
    manifest.cpu_seconds = round(time.process_time() - start_cpu_s, 3)
    results.finish(task.chunk.name, manifest)
    return manifest


def _write(
    task: ChunkTask, row: int, planned: PlannedItem, cloud: Cloud, results: TakeResults, manifest: ChunkManifest
) -> None:
    """Write the file of a cloud, as a replay does, or its row of the store."""
    parts, kind = task.job.parts, task.job.kind
    saved = SavedCloud.of(cloud).completed(parts, task.url)
    if kind == "zarr":
        write_row(results.folder, row, saved)
        return
    name = cloud_name(planned.sequence, kind)
    write_whole(results.folder / name, cloud_bytes(saved, kind, parts or None))
    manifest.files.append(name)


def shares(cloud: Cloud, points: int) -> dict[str, float]:
    """Share of the pixels that have a point, and share of the lit ones that have none, of every fourth row."""
    valid = np.isfinite(cloud.xyz[::4, :, 2])
    lit = cloud.modulation[0][::4] >= _LIT
    rejected = int(np.count_nonzero(lit & ~valid)) / max(1, int(np.count_nonzero(lit)))
    return {"coverage": round(points / cloud.gray.size, 6), "rejected": round(rejected, 6)}


def reconstructor_for(
    take: TakeReader, job: Job, calibration: CalibrationFile, encoding: str, state: CarriedState
) -> tuple[Any, CarriedState]:
    """A reconstructor in this state, or in its first one for images of another encoding."""
    attached = [take.attachments.get(name, b"").hex() for name in ("pattern.json", "volume.json")]
    options = dataclasses.asdict(job.settings), job.calibration_check, job.use_prior, job.fuse, job.threads
    key = json.dumps([calibration.identity, attached, encoding, options])
    if job.fuse and state.encoding != encoding:
        # One that has made no cloud yet, as in a replay: the average is no carried state.
        _reconstructors.pop(key, None)
    if key not in _reconstructors:
        made = warmed_reconstructor(
            calibration.calibration, take.sequence() or take.pattern(), take.volume(), encoding=encoding,
            settings=job.settings, threads=job.threads, use_prior=job.use_prior, policy=job.calibration_check,
            fuse=job.fuse,
        )  # fmt: skip
        _reconstructors[key] = made, capture(made)
        if len(_reconstructors) > _RECONSTRUCTORS:
            _reconstructors.popitem(last=False)
    _reconstructors.move_to_end(key)
    reconstructor, first = _reconstructors[key]
    state = state if state.encoding == encoding else first
    if capture(reconstructor) != state:
        restore(reconstructor, state)
    return reconstructor, state


def calibration_of(take: TakeReader, job: Job) -> CalibrationFile:
    """The calibration of the job, or else the one that is attached to the take."""
    if job.calibration is None:
        return take.calibration()
    return check_serials(take, parse_calibration(job.calibration, "--calibration"))


class _OpenTake:
    """The take that was read last stays open: its next chunk needs no index again."""

    def __init__(self) -> None:
        self._key: tuple[str, int, int, float] | None = None
        self._take: TakeReader | None = None

    def get(self, url: str, size: int) -> TakeReader:
        """The take, opened again when its first file or the size of all has changed."""
        path = location(url)
        try:
            status = path.stat()
            key = url, size, int(status.st_size), float(status.st_mtime)
        except FileNotFoundError:
            key = url, size, 0, 0.0  # only later parts are left of it
        if self._take is None or key != self._key:
            self.close()
            self._take, self._key = TakeReader(path), key
        return self._take

    def close(self) -> None:
        """Close its files."""
        if self._take is not None:
            self._take.close()
        self._take = None


_open_take = _OpenTake()
