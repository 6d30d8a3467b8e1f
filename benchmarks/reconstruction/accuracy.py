"""Coverage, wrong orders and error of every case, against the simulator's truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import Case
from benchmarks.reconstruction.speed import mean_score
from sim.evaluate.score import score


def by_case(cases: Sequence[Case], seeds: int) -> tuple[Table, dict[str, Any], list[tuple[str, bool]]]:
    """The table, plain figures by case, and the promises with whether each is kept."""
    headings = ["case", "within 1 mm %", "wrong %", "rms um", "5x5 rms um", "bias um", "points", "promise"]
    table = Table(
        "accuracy", f"Accuracy by case, {seeds} seed{'s' * (seeds != 1)}", headings, text_columns=("promise",)
    )
    figures: dict[str, Any] = {}
    promises = []
    for case in cases:
        found = mean_score([_of_seed(case, seed) for seed in range(seeds)])
        figures[case.name] = asdict(found)
        verdict = ""
        if case.promise is not None:
            share, wrong, rms = case.promise
            good = found.reconstructed >= share and found.wrong <= wrong and found.rms_mm <= rms
            limits = f"{100 * share:.1f} / {100 * wrong:.2f} / {1e3 * rms:.0f}"
            verdict = f"{'kept' if good else 'MISSED'} {limits}"
            promises.append((f"{case.name}: promised {limits}", good))
        table.add(
            case.name, f"{100 * found.reconstructed:.2f}", f"{100 * found.wrong:.3f}", f"{1e3 * found.rms_mm:.0f}",
            f"{1e3 * found.smooth_rms_mm:.0f}", f"{1e3 * found.bias_mm:+.1f}", f"{found.points}", verdict,
        )  # fmt: skip
    table.notes.append("Every pair by itself, one set of settings. Promise: within 1 mm / wrong / rms.")
    return table, figures, promises


def _of_seed(case: Case, seed: int) -> Any:
    pair = rendered.stored_pair(case, seed)
    return score(case.reconstructor().reconstruct(pair.left, pair.right).xyz, pair.truth_left)
