"""report.json and report.html of a run."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from daemon.apps.reprocess.job import Job
from daemon.apps.reprocess.locations import write_whole
from daemon.apps.reprocess.report.page import grid_page, report_page
from daemon.apps.reprocess.report.totals import BINS, TakeTotals, Totals

WORST = 10


def write_report(root: Path, job: Job, totals: Totals, *, seconds: float) -> Path:
    """Write both files; returns the place of the page."""
    values = report_values(job, totals, seconds=seconds)
    write_whole(root / "report.json", (json.dumps(values, indent=1) + "\n").encode())
    write_whole(root / "report.html", report_page(values))
    return root / "report.html"


def write_grid(root: Path, job: Job, rows: Sequence[dict[str, Any]], sample: int) -> Path:
    """Write grid.json and grid.html, the comparison of settings; returns the place of the page."""
    values = {"job": job.describe(), "sample": sample, "rows": list(rows)}
    write_whole(root / "grid.json", (json.dumps(values, indent=1) + "\n").encode())
    write_whole(root / "grid.html", grid_page(values))
    return root / "grid.html"


def report_values(job: Job, totals: Totals, *, seconds: float) -> dict[str, Any]:
    """The plain values of ``report.json``."""
    return {
        "job": job.describe(),
        "changed_settings": job.changed_settings(),
        "seconds": round(seconds, 3),
        "recordings": totals.recordings,
        "items": totals.items,
        "bytes": totals.bytes,
        "done": totals.done,
        "computed": totals.computed,
        "items_per_second": round(totals.computed / seconds, 3) if seconds > 0 else 0.0,
        "means": totals.sums.means(),
        "histograms": {
            name: {"edges": list(edges), "counts": totals.sums.histograms[name].tolist()}
            for name, edges in BINS.items()
        },
        "worst": [take.name for take in worst(totals.closed)],
        "failures": totals.failures,
        "per_recording": [take.as_json() for take in sorted(totals.closed, key=lambda take: take.name)],
    }


def worst(takes: list[TakeTotals]) -> list[TakeTotals]:
    """The worst recordings: those with failures, then by inconsistent pairs, then by coverage."""

    def rank(take: TakeTotals) -> tuple[bool, float, float, str]:
        clouds = max(1, take.sums.clouds)
        refuted = take.sums.verdicts.get("inconsistent", 0) / clouds
        return not take.failures, -refuted, take.sums.coverage / clouds, take.name

    return sorted(takes, key=rank)[:WORST]
