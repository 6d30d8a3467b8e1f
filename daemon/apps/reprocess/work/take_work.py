"""Tasks of a worker that concern a whole recording: its plan with what is done already, and its summary."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Collection
from contextlib import suppress
from dataclasses import dataclass, field
from statistics import median
from typing import Any

from daemon.apps.replay.reconstruct_item import Run
from daemon.apps.replay.summary import NAME, stage_medians
from daemon.apps.reprocess.carried_state import CarriedState
from daemon.apps.reprocess.destination.cloud_store import prepare_store
from daemon.apps.reprocess.destination.results import TakeResults
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location, remote, write_whole
from daemon.apps.reprocess.plan.chunk_plan import TakePlan, plan_take
from daemon.apps.reprocess.plan.take_heads import Place
from daemon.apps.reprocess.work.chunk_work import ChunkOutcome, calibration_of
from daemon.common.errors import DaemonError
from daemon.recording.read.take_reader import TakeReader
from pipeline.common.errors import PipelineError


@dataclass(slots=True)
class Planned:
    """A plan and what earlier runs left of it.

    Args:
        done: by number of the chunk, the state before it and its outcome.
        failed: by number of the chunk, the reason.
        error, transient: the recording cannot be planned; another attempt may succeed.
    """

    plan: TakePlan | None = None
    keys: list[str] = field(default_factory=list)
    done: dict[int, tuple[CarriedState, ChunkOutcome]] = field(default_factory=dict)
    failed: dict[int, str] = field(default_factory=dict)
    error: str = ""
    transient: bool = False


def prepare_recording(job: Job, url: str, folder: str, excluded: Collection[Place]) -> Planned:
    """Plan a recording, and remove what other settings or another state of the file left in its folder."""
    out = plan_recording(job, url, folder, excluded)
    if out.plan is not None:
        try:
            names = (chunk.name for chunk in out.plan.chunks)
            TakeResults(location(folder)).keep_only(dict(zip(names, out.keys, strict=True)))
            if job.kind == "zarr":
                _prepare_store(job, url, folder, out.plan)
        except (DaemonError, PipelineError, OSError) as error:
            return Planned(error=str(error), transient=isinstance(error, OSError))
        except Exception as error:
            return Planned(error=f"{type(error).__name__}: {error}", transient=remote(url, folder))
    return out


def _prepare_store(job: Job, url: str, folder: str, plan: TakePlan) -> None:
    """Make the Zarr store of a recording."""
    with TakeReader(location(url)) as take:
        size = calibration_of(take, job).calibration.left.size
    sequences = [item.sequence for chunk in plan.chunks for item in chunk.items]
    prepare_store(location(folder), sequences, size, job.parts)


def _layout(job: Job, plan: TakePlan) -> str:
    """What the place of a cloud in a store depends on besides its own chunk."""
    if job.kind != "zarr":
        return ""
    numbers = [item.sequence for chunk in plan.chunks for item in chunk.items]
    return hashlib.sha256(json.dumps(numbers).encode()).hexdigest()


def plan_recording(job: Job, url: str, folder: str, excluded: Collection[Place] = ()) -> Planned:
    """Plan a recording and find its finished and failed chunks; nothing is changed."""
    try:
        plan = plan_take(
            location(url), chunk_pairs=job.chunk_pairs, use_prior=job.use_prior, fuse=job.fuse, excluded=excluded
        )
        results = TakeResults(location(folder))
        layout = _layout(job, plan)
        out = Planned(plan, [job.key(chunk.source() + layout, plan.attachments) for chunk in plan.chunks])
        for number, (chunk, key) in enumerate(zip(plan.chunks, out.keys, strict=True)):
            manifest = results.manifest(chunk.name)
            if manifest is not None and manifest.key == key:
                out.done[number] = manifest.before, ChunkOutcome.of(manifest)
            elif reason := results.failure(chunk.name, key):
                out.failed[number] = reason
    except (DaemonError, PipelineError, OSError) as error:
        cause = error if isinstance(error, OSError) else error.__cause__
        lasting = isinstance(cause, FileNotFoundError | PermissionError | NotADirectoryError)
        return Planned(error=str(error), transient=isinstance(cause, OSError) and not lasting)
    except Exception as error:
        return Planned(error=f"{type(error).__name__}: {error}", transient=remote(url, folder))
    return out


def finish_recording(job: Job, url: str, folder: str, plan: TakePlan) -> str:
    """Write the summary of a recording whose chunks are all done; returns the reason if that fails."""
    try:
        results = TakeResults(location(folder))
        write_whole(results.folder / NAME, (json.dumps(_summary(job, url, results, plan), indent=1) + "\n").encode())
        results.remove_unfinished_files()
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    return ""


def forget_summary(folder: str) -> None:
    """Remove the summary of a recording that is no longer whole."""
    with suppress(Exception):  # a store that fails; the report has the failure
        (location(folder) / NAME).unlink()


def _summary(job: Job, url: str, results: TakeResults, plan: TakePlan) -> dict[str, Any]:
    """The values of a replay's summary, from the manifests in the order of the take."""
    rows: list[dict[str, Any]] = []
    failed: list[dict[str, Any]] = []
    problems, calibration = list(plan.problems), ""
    for chunk in plan.chunks:
        manifest = results.manifest(chunk.name)
        if manifest is None:
            raise DaemonError(f"{results.folder}: the manifest of {chunk.name} has gone; run again")
        rows += manifest.rows
        failed += manifest.failed
        calibration = manifest.calibration
        problems += [problem for problem in manifest.problems if problem not in problems]
    sets = {} if plan.mode == "single" else {
        "mode": plan.mode, "frames": plan.frames, "sets": plan.items, "sets_incomplete": plan.incomplete,
    }  # fmt: skip
    middle_ms = median(row["total_ms"] for row in rows) if rows else 0.0
    runs = [Run(row["sequence"], row["points"], row["total_ms"], row["ms"], row["consistency"]) for row in rows]
    checks = [row["consistency"] for row in rows if row["consistency"] is not None]
    reasons = [check["reason"] for check in checks if check["verdict"] == "inconsistent"]
    return {
        "take": url,
        "session": plan.metadata.get("session"),
        "device": plan.metadata.get("device"),
        "calibration": calibration,
        "settings": job.changed_settings(),
        "threads": job.threads,
        "follow": job.use_prior,
        "calibration_check": {
            "policy": job.calibration_check,
            **Counter(check["verdict"] for check in checks),
            **({"reason": reasons[0]} if reasons else {}),
        },
        **sets,
        "pairs": plan.items if plan.mode == "single" else plan.pairs,
        "clouds": len(rows),
        "pairs_per_second": round(1000 / middle_ms, 3) if middle_ms > 0 else 0.0,
        "ms": stage_medians(runs),
        "unpaired": plan.unpaired,
        "duplicates": plan.duplicates,
        "failed": failed,
        "problems": problems,
        "per_pair": rows,
    }
