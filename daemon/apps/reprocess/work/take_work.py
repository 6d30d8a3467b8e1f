"""Tasks of a worker that concern a whole recording: its plan with what is done already, and its summary."""

from __future__ import annotations

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
from daemon.apps.reprocess.destination.results import TakeResults
from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import location, write_whole
from daemon.apps.reprocess.plan.chunk_plan import TakePlan, plan_take
from daemon.apps.reprocess.plan.take_heads import Place
from daemon.apps.reprocess.work.chunk_work import ChunkOutcome
from daemon.common.errors import DaemonError
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
        except OSError as error:
            return Planned(error=str(error), transient=True)
    return out


def plan_recording(job: Job, url: str, folder: str, excluded: Collection[Place] = ()) -> Planned:
    """Plan a recording and find its finished and failed chunks; nothing is changed."""
    try:
        plan = plan_take(location(url), chunk_pairs=job.chunk_pairs, use_prior=job.use_prior, excluded=excluded)
        results = TakeResults(location(folder))
        out = Planned(plan, [job.key(chunk.source(), plan.attachments) for chunk in plan.chunks])
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
    return out


def finish_recording(job: Job, url: str, folder: str, plan: TakePlan) -> str:
    """Write the summary of a recording whose chunks are all done; returns the reason if that fails."""
    try:
        results = TakeResults(location(folder))
        write_whole(results.folder / NAME, (json.dumps(_summary(job, url, results, plan), indent=1) + "\n").encode())
        results.remove_unfinished_files()
    except (DaemonError, OSError, KeyError) as error:
        return str(error)
    return ""


def forget_summary(folder: str) -> None:
    """Remove the summary of a recording that is no longer whole."""
    with suppress(OSError):
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
