"""Coverage, wrong orders and error of every case, against the simulator's truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import Case
from benchmarks.reconstruction.speed import mean_score
from sim.evaluate.cramer_rao import depth_bound_mm
from sim.evaluate.score import RIGHT_MM, Score, score

_WINDOW = 9
"""Pixels of which a three-chip image's phase is fitted."""
_PLAIN, _MOST_OF_BOUND = "bare white plane", 1.3


def by_case(cases: Sequence[Case], seeds: int) -> tuple[Table, dict[str, Any], list[tuple[str, bool]]]:
    """The table, plain figures by case, and the promises with whether each is kept."""
    headings = [
        "case",
        "within 1 mm %",
        "wrong %",
        "rms um",
        "5x5 rms um",
        "bound um",
        "rms / bound",
        "bias um",
        "points",
        "promise",
    ]
    table = Table(
        "accuracy", f"Accuracy by case, {seeds} seed{'s' * (seeds != 1)}", headings, text_columns=("promise",)
    )
    figures: dict[str, Any] = {}
    promises = []
    for case in cases:
        scores, bounds = zip(*(_of_seed(case, seed) for seed in range(seeds)), strict=True)
        found, bound = mean_score(scores), float(np.mean(bounds))
        ratio = found.rms_mm / bound
        limit = ("", "") if np.isnan(bound) else (f"{1e3 * bound:.0f}", f"{ratio:.2f}")
        figures[case.name] = asdict(found) | {"bound_mm": bound}
        verdict = ""
        if case.promise is not None:
            share, wrong, rms = case.promise
            good = found.reconstructed >= share and found.wrong <= wrong and found.rms_mm <= rms
            limits = f"{100 * share:.1f} / {100 * wrong:.2f} / {1e3 * rms:.0f}"
            verdict = f"{'kept' if good else 'MISSED'} {limits}"
            promises.append((f"{case.name}: promised {limits}", good))
        if case.name == _PLAIN:
            promises.append((f"{case.name}: rms at most {_MOST_OF_BOUND} bounds", ratio <= _MOST_OF_BOUND))
        table.add(
            case.name, f"{100 * found.reconstructed:.2f}", f"{100 * found.wrong:.3f}", f"{1e3 * found.rms_mm:.0f}",
            f"{1e3 * found.smooth_rms_mm:.0f}", *limit,
            f"{1e3 * found.bias_mm:+.1f}", f"{found.points}", verdict,
        )  # fmt: skip
    table.notes.append("Every pair by itself, one set of settings. Promise: within 1 mm / wrong / rms.")
    table.notes.append(
        f"Bound: Cramer-Rao bound of {_WINDOW} pixels, those of the phase's window, from the noise of photons, reading "
        "and rounding; three-chip images, pixels without a saturated sample. rms holds every other error, too."
    )
    return table, figures, promises


def _of_seed(case: Case, seed: int) -> tuple[Score, float]:
    """Score of a pair, and the root mean square of the bound, mm; NaN for a mosaic."""
    pair = rendered.stored_pair(case, seed)
    found = score(case.reconstructor().reconstruct(pair.left, pair.right).xyz, pair.truth_left)
    if case.encoding != "rgb8":
        return found, float("nan")
    calibration = case.layout.calibration_for(case.optics)
    bound = depth_bound_mm(pair.left, pair.right, pair.truth_left, calibration, case.pattern, case.optics)
    usable = pair.truth_left.scorable & (bound < RIGHT_MM)
    return found, float(np.sqrt(np.mean(bound[usable] ** 2) / _WINDOW))
