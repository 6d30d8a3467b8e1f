"""Rejection of images and views that do not fit the adjustment."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.calibrate.bundle.adjust.adjustment import Adjusted
from pipeline.calibrate.bundle.adjust.levenberg_marquardt import residuals
from pipeline.calibrate.bundle.adjust.observations import Observations
from pipeline.calibrate.bundle.options import Options
from pipeline.calibrate.bundle.solution import Rejection
from pipeline.calibrate.targets.board.board import Board
from pipeline.calibrate.targets.marks import BoardView

Array = NDArray[np.float64]


def few_marks(
    data: Observations, board: Board, views: Sequence[BoardView], devices: Sequence[str], options: Options
) -> tuple[Observations, list[Rejection]]:
    """Reject images with too few marks, or with marks on a single line."""
    rejected, usable = list[Rejection](), np.ones(len(data), dtype=bool)
    for device, view, where in data.groups():
        count = where.stop - where.start
        if count < options.least_marks:
            usable[where] = False
            reason = f"{count} marks detected, at least {options.least_marks} are needed"
            rejected.append(Rejection(views[view].name, devices[device], (), reason))
        elif _width(board.points[data.mark[where], :2]) < 0.25 * board.pitch_mm:
            usable[where] = False
            reason = f"the {count} marks detected lie on one line, which has no pose"
            rejected.append(Rejection(views[view].name, devices[device], (), reason))
    used = set(np.unique(data.view).tolist())
    rejected += [Rejection(view.name, "", (), "no marks") for k, view in enumerate(views) if k not in used]
    return data.some(usable), rejected


def _width(points: Array) -> float:
    """Standard deviation of points (n, 2) across their longest direction."""
    return float(np.linalg.svd(points - points.mean(axis=0), compute_uv=False)[1] / np.sqrt(len(points)))


def bad_views(
    adjusted: Adjusted, names: Sequence[str], devices: Sequence[str], options: Options
) -> list[tuple[int, int | None, Rejection]]:
    """The worst view, if it does not fit the others: (view, device or None for all of them, reason).

    One at a time, because a bad view distorts the others. The criterion is the median length of an image's residuals
    (rejected marks included) against the median of the device's images.
    """
    if options.loss == "squared":
        return []
    candidates: list[tuple[float, int, int, str]] = []
    all_lengths = _all_lengths(adjusted)
    for device, name in enumerate(devices):
        own = {view: lengths for (d, view), lengths in all_lengths.items() if d == device}
        if len(own) < 3:
            continue
        typical = {view: float(np.median(lengths[0])) for view, lengths in own.items()}
        usual = float(np.median(list(typical.values())))
        for view, (lengths, out) in own.items():
            worse = typical[view] / max(usual, 1e-12)
            if out > 0.3 * len(lengths):
                reason = f"{out} of {len(lengths)} marks of {name} do not fit the other views"
                candidates.append((max(worse, 1.0) + 10, view, device, reason))
            elif worse > options.view_limit and typical[view] > 1e-6:
                reason = (
                    f"its residuals in {name} are {worse:.1f} times the usual (median {typical[view]:.3g} px against "
                    f"{usual:.3g} px, limit {options.view_limit:g} times): it moved, is blurred or mis-numbered"
                )
                candidates.append((worse, view, device, reason))
    if not candidates:
        return []
    _, view, device, reason = max(candidates)
    count = sum(1 for d, v in all_lengths if v == view)
    if count > 2 and sum(1 for _, v, _, _ in candidates if v == view) == 1:
        return [(view, device, Rejection(names[view], devices[device], (), reason))]
    return [(view, None, Rejection(names[view], "", (), reason))]


def _all_lengths(adjusted: Adjusted) -> dict[tuple[int, int], tuple[Array, int]]:
    """(device, view) -> lengths of all residuals in px, and the number of rejected marks."""
    used, out = adjusted.data, adjusted.out
    misfit = np.linalg.norm(residuals(adjusted.state, used, adjusted.offsets), axis=1)
    result = {}
    lengths_out = adjusted.out_by * out.sigma
    keys = {(d, v) for d, v, _ in used.groups()} | {(d, v) for d, v, _ in out.groups()}
    for device, view in sorted(keys):
        a = misfit[(used.device == device) & (used.view == view)]
        b = lengths_out[(out.device == device) & (out.view == view)]
        result[device, view] = (np.concatenate([a, b]), len(b))
    return result
