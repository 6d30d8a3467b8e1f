"""summary.json: the results and times of a replay."""

from __future__ import annotations

import dataclasses
import json
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from daemon.apps.replay.reconstruct_item import Run, problems_of
from daemon.apps.replay.runner import Replay
from daemon.common.files import write_atomically
from pipeline.common.settings import Settings

NAME = "summary.json"


def summary_of(replay: Replay, runs: Sequence[Run]) -> dict[str, Any]:
    """The plain values of ``summary.json``; repeated runs count too."""
    defaults = dataclasses.asdict(Settings())
    changed = {k: v for k, v in dataclasses.asdict(replay.settings).items() if v != defaults[k]}
    counts = replay.take.counts
    sequence = replay.sequence
    sets = {} if sequence is None else {
        "mode": sequence.name, "frames": len(sequence), "sets": len(runs) + len(replay.failures),
        "sets_incomplete": replay.incomplete,
    }  # fmt: skip
    middle_ms = median(run.total_ms for run in runs) if runs else 0.0
    return {
        "take": str(replay.take.path),
        "complete": True,
        "session": replay.take.metadata.get("session"),
        "device": replay.take.metadata.get("device"),
        "calibration": replay.calibration_file.identity,
        **_calibration_sigma(replay.calibration_file.mapping),
        "settings": changed,
        "threads": replay.threads,
        "follow": replay.use_prior,
        "calibration_check": _verdicts(replay, runs),
        **sets,
        "pairs": len(runs) + len(replay.failures) if sequence is None else counts.pairs,
        "clouds": len(runs),
        "pairs_per_second": round(1000 / middle_ms, 3) if middle_ms > 0 else 0.0,
        "ms": stage_medians(runs),
        "unpaired": dict(counts.unpaired),
        "duplicates": dict(counts.duplicates),
        "failed": [dataclasses.asdict(failure) for failure in replay.failures],
        "problems": [*problems_of(replay.take, replay.calibration_file), *replay.warnings],
        "per_pair": [dataclasses.asdict(run) for run in runs],
    }


def _calibration_sigma(mapping: Mapping[str, Any]) -> dict[str, float]:
    """Standard deviation of depths from the calibration, mm, where its file has it."""
    quality = mapping.get("quality")
    value = quality.get("sigma_calibration_mm") if isinstance(quality, Mapping) else None
    return {"sigma_calibration_mm": float(value)} if isinstance(value, int | float) else {}


def _verdicts(replay: Replay, runs: Sequence[Run]) -> dict[str, Any]:
    """Policy, number of runs by verdict, and the first reason of an inconsistent one."""
    checks = [run.consistency for run in runs if run.consistency is not None]
    reasons = [check["reason"] for check in checks if check["verdict"] == "inconsistent"]
    return {
        "policy": replay.calibration_check,
        **Counter(check["verdict"] for check in checks),
        **({"reason": reasons[0]} if reasons else {}),
    }


def stage_medians(runs: Sequence[Run]) -> dict[str, float]:
    """Median time of each stage, ms, in the order of the stages, over the runs with that stage."""
    stages: dict[str, list[float]] = {}
    for run in runs:
        for name, ms in run.ms.items():
            stages.setdefault(name, []).append(ms)
    return {name: round(median(values), 3) for name, values in stages.items()}


def write_summary(directory: Path, summary: dict[str, Any]) -> None:
    """Write ``summary.json``."""
    write_atomically(directory / NAME, (json.dumps(summary, indent=1) + "\n").encode())
