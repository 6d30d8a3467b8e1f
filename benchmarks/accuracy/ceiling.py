"""What the phases of a pair allow: every pixel with its true fringe order, and no filter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.tables import Table
from benchmarks.reconstruction import rendered
from benchmarks.reconstruction.cases import Case
from pipeline.fringe_order.left_right_check import UNDECIDED
from pipeline.match.match_result import Points
from pipeline.reconstruct.reconstructor import Reconstructor
from sim.evaluate.point_errors import RINGS, distance_mm, distance_to_edge
from sim.evaluate.score import RIGHT_MM
from sim.render.ground_truth import Truth

Bools = NDArray[np.bool_]


def table_of(cases: Sequence[Case], seeds: int) -> Table:
    """Share of the measurable pixels within 1 mm: of the clouds, and with true orders and without filters."""
    names = [name for name, _, _ in RINGS]
    table = Table(
        "ceiling",
        "Measurable pixels within 1 mm, %: of the clouds, and with true fringe orders and no filter",
        ["case", "clouds", "true orders", *(f"{name}" for name in names)],
    )
    for case in cases:
        found = np.mean([_shares(case, seed) for seed in range(seeds)], axis=0)
        table.add(case.name, *(f"{100 * share:.2f}" for share in found))
    table.notes.append(
        "The last columns split the one before by the distance to an edge. Errors of the order search and of the "
        "filters are not included, nor what these must reject because it is wrong."
    )
    return table


def _shares(case: Case, seed: int) -> list[float]:
    pair = rendered.stored_pair(case, seed)
    truth, reconstructor = pair.truth_left, case.reconstructor()
    cloud = reconstructor.reconstruct(pair.left, pair.right)
    volume = case.layout.volume()
    measurable = truth.scorable & (truth.xyz[..., 2] >= volume.near_mm) & (truth.xyz[..., 2] <= volume.far_mm)
    right = _right_with_true_orders(reconstructor, pair, truth)
    edges = distance_to_edge(truth, measurable)
    rings = [measurable & (edges >= least) & (edges < limit) for _, least, limit in RINGS]
    with np.errstate(invalid="ignore"):
        kept = distance_mm(cloud.xyz, truth) < RIGHT_MM
    return [float(kept[measurable].mean()), *(float(right[m].mean()) for m in (measurable, *rings))]


def _right_with_true_orders(made: Reconstructor, pair: Any, truth: Truth) -> Bools:
    """Pixels (H, W) whose match has an error below 1 mm when the order is the true one."""
    left, right = made.decode(pair.left, pair.right)
    known = truth.scorable & left.valid
    pixels = made.calibration.projector.project(np.where(known[..., None], truth.xyz, [0.0, 0.0, 1000.0]))
    where = pixels[..., 0 if made.pattern.axis == "x" else 1]
    phase = np.interp(where, np.arange(made.pattern.length), made.pattern.phase)
    order = np.where(known, np.rint((phase - left.phase) / (2 * np.pi)), UNDECIDED).astype(np.int16)
    points = Points.empty(truth.scorable.shape)
    match = made.stage(1).match(left, right, order, made.correction, points)
    with np.errstate(invalid="ignore", over="ignore"):
        return np.asarray((match.valid != 0) & (distance_mm(points.xyz, truth) < RIGHT_MM))
