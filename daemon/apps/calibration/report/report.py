"""What the report of a calibration says, section by section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from html import escape

import numpy as np

from daemon.apps.calibration.report.charts import COLORS, coverage_map, histogram, vector_scale, view_bars, view_image
from daemon.apps.calibration.views.detect_marks import Seen
from daemon.common.html_page import Card, figure, items, page, table
from pipeline.calibrate.bundle import Solution
from pipeline.calibrate.bundle.adjust.state import INTRINSICS, POSE
from pipeline.calibrate.bundle.quality.solution_figures import values_of, view_figures
from pipeline.rig.calibration import Cameras

_EMPTY = np.empty((0, 2))
MOST_IMAGES = 60
"""Images in a report; each takes some 50 kilobytes."""


@dataclass(frozen=True, slots=True)
class Report:
    """What there is to report.

    Args:
        title, created, board, sources: for the head of the page.
        solution: with its residuals; seen: the images.
        coverage: share of each device's image that saw marks.
        cameras: as they are written to the file; before: those of the file that was there, ``before_name`` its date.
        notes: sentences about what was done; advice: sentences about what would make it better.
    """

    title: str
    created: datetime
    board: str
    sources: Sequence[str]
    solution: Solution
    seen: Sequence[Seen]
    cameras: Cameras
    coverage: Mapping[str, float]
    before: Cameras | None = None
    before_name: str = ""
    notes: Sequence[str] = field(default_factory=list)
    advice: Sequence[str] = field(default_factory=list)
    problems: Sequence[str] = field(default_factory=list)


def report_html(report: Report) -> bytes:
    """The file's bytes, UTF-8."""
    solution = report.solution
    lines = [
        f"{report.created:%d %B %Y, %H:%M} UTC · board {report.board} · {', '.join(report.sources)}",
        f"Scale from {solution.scale}." if solution.scale else "",
    ]
    sections = [
        ("What to do", items(report.advice)),
        ("Notes", items(report.notes)),
        ("Errors of every view", _views(solution)),
        ("Left out", _left_out(report)),
        ("Coverage", _coverage(solution)),
        ("Residuals", _residuals(solution)),
        ("Parameters", _parameters(report)),
        ("Images", _images(report)),
    ]
    return page(report.title, [line for line in lines if line], _cards(report), sections)


def _cards(report: Report) -> list[Card]:
    solution = report.solution
    cards = [Card("reprojection error, both cameras", f"{solution.rms_stereo:.3f}", "px rms")]
    if np.isfinite(solution.epipolar_px):
        cards.append(Card("epipolar error", f"{solution.epipolar_px:.3f}", "px mean"))
    if "projector" in solution.rms:
        cards.append(Card("reprojection error, projector", f"{solution.rms['projector']:.3f}", "px rms"))
    level = "good" if solution.views_rejected == 0 else "warn"
    of = solution.views_used + solution.views_rejected
    cards.append(Card("views used", f"{solution.views_used}", f"of {of}", level))
    if np.isfinite(solution.baseline_mm):
        sigma = solution.sigma.get("baseline_mm", float("nan"))
        cards.append(Card("baseline", f"{solution.baseline_mm:.2f}", f"± {sigma:.2g} mm"))
    for device, share in report.coverage.items():
        level = "good" if share > 0.7 else "warn" if share > 0.45 else "bad"
        cards.append(Card(f"coverage, {device}", f"{100 * share:.0f}", "%", level))
    return cards


def _views(solution: Solution) -> str:
    figures = view_figures(solution)
    series = [
        (f"{device} rms", COLORS[device], [view.rms.get(device, float("nan")) for view in figures])
        for device in solution.devices
    ]
    if "right" in solution.devices:
        series.append(("epipolar", "#2f8f6b", [view.epipolar_px for view in figures]))
    return figure(
        view_bars([view.name for view in figures], series, "px"),
        "Root mean square of the distances between marks and their predicted places, and the mean distance of marks "
        "from the epipolar lines of their partners. A view that stands out was moved, or is blurred.",
    )


def _left_out(report: Report) -> str:
    rows = [(seen.view, seen.device, "all marks", seen.problem) for seen in report.seen if seen.found is None]
    for rejection in report.solution.rejected:
        marks = ", ".join(map(str, rejection.ids)) if rejection.ids else "all marks"
        why = f"{rejection.reason} (repaired, used)" if rejection.repaired else rejection.reason
        rows.append((rejection.view, rejection.device or "all", marks, why))
    rows += [("", "", "", problem) for problem in report.problems]
    if not rows:
        return "<p>Nothing: every mark of every image was used.</p>"
    return table(("view", "device", "marks", "why"), rows, text=range(4))


def _coverage(solution: Solution) -> str:
    scale = _common_scale(solution)
    out = []
    for device, model in solution.devices.items():
        pixels, misfit = _all(solution, device)
        out.append(
            figure(
                coverage_map(model.size, pixels, misfit, scale=3 * scale, color=COLORS[device]),
                f"{device}, {model.size[0]} x {model.size[1]} pixels: every mark of every view; red cells saw none. "
                f"Arrows: mean residual of a cell, drawn {3 * scale:g} times as long.",
            )
        )
    return (
        "<p>The lens is known where marks were seen. Arrows that turn together mean that the lens model does not fit; "
        f'without any order they are noise.</p><div class="pair">{"".join(out)}</div>'
    )


def _residuals(solution: Solution) -> str:
    out = []
    for device in solution.devices:
        _, misfit = _all(solution, device)
        sigma = float(np.sqrt((misfit**2).mean())) if len(misfit) else 1.0
        out.append(
            figure(
                histogram(misfit, max(sigma, 1e-9), color=COLORS[device]),
                f"{device}: residuals in px, {len(misfit)} marks, {sigma:.4f} px in each direction. Filled: u, "
                "line: v, dashed: a normal distribution of that width.",
            )
        )
    return f'<div class="pair">{"".join(out)}</div>'


def _parameters(report: Report) -> str:
    solution = report.solution
    before = values_of(report.before) if report.before is not None else {}
    first = next(iter(solution.devices))
    groups: list[tuple[str, list[tuple[str, str]]]] = []
    for device in solution.devices:
        keys = INTRINSICS if device == first else (*INTRINSICS, *POSE)
        groups.append((device, [(f"{device}.{key}", key) for key in keys]))
    groups.append(("rig", [(name, name) for name in ("baseline_mm", "angle_deg") if name in solution.values]))
    tables = [_table(report, before, heading, names) for heading, names in groups if names]
    text = (
        "<p>One standard deviation, from the residuals and the geometry of all views together. fx, fy, skew, cx, cy in "
        "pixels; rotations as a rotation vector in radians; translations in mm.</p>"
    )
    if before:
        text += (
            f"<p>Before: {escape(report.before_name)}. Red: changed by more than five standard deviations; something "
            "was moved, refocused or replaced.</p>"
        )
    wide = " wide" if before else ""
    return f'{text}<div class="tables{wide}">{"".join(tables)}</div>'


def _table(report: Report, before: Mapping[str, float], heading: str, names: Sequence[tuple[str, str]]) -> str:
    """Values and standard deviations of some parameters, (name, shown name), beside those before."""
    rows: list[list[str]] = []
    out: list[int] = []
    for name, shown in names:
        value, sigma = report.solution.values.get(name), report.solution.sigma.get(name, 0.0)
        if value is None:
            continue
        row = [shown, _rounded(value, sigma), f"{sigma:.2g}" if sigma > 0 else "held"]
        was = before.get(name)
        if before:
            row += [_rounded(was, sigma), _rounded(value - was, sigma, sign="+")] if was is not None else ["", ""]
            ratio = abs(value - was) / sigma if was is not None and sigma > 0 else None
            row.append(f"{ratio:.1f}" if ratio is not None else "")
            if ratio is not None and ratio > 5:
                out.append(len(rows))
        rows.append(row)
    head = ["", "value", "std. dev."] + (["before", "change", "in std. dev."] if before else [])
    return f"<div><h3>{escape(heading)}</h3>{table(head, rows, out=out)}</div>"


def _images(report: Report) -> str:
    scale = _common_scale(report.solution)
    out = []
    shown, rest = _worst(report)
    for seen in shown:
        residuals = report.solution.residuals.get((seen.view, seen.device))
        used, misfit = (residuals.pixels, residuals.misfit) if residuals is not None else (_EMPTY, _EMPTY)
        left_out = _EMPTY
        if seen.found is not None:
            marks = seen.found.marks
            kept = np.isin(marks.ids, residuals.ids) if residuals is not None else np.zeros(len(marks), np.bool_)
            left_out = marks.pixels[~kept] if residuals is None or len(used) < len(marks) else _EMPTY
        svg = view_image(seen.size, seen.thumbnail, used, misfit, left_out, scale=scale, color="#35d07f")
        out.append(figure(svg, _caption(seen, used, misfit)))
    text = (
        f"Green: marks used; red lines: from each to where the calibrated model puts it, drawn {scale:g} times as "
        "long; amber crosses: marks left out."
    )
    text += f" The worst views are shown, {rest} images are not." if rest else ""
    return f'<p>{text}</p><div class="grid">{"".join(out)}</div>'


def _worst(report: Report) -> tuple[list[Seen], int]:
    """The images to show, in order: all of them, or the ones of the worst views; and how many are not shown."""
    if len(report.seen) <= MOST_IMAGES:
        return list(report.seen), 0
    errors = {view.name: max(view.rms.values(), default=np.inf) for view in view_figures(report.solution)}
    views = sorted({seen.view for seen in report.seen}, key=lambda name: -errors.get(name, np.inf))
    chosen = set(views[: MOST_IMAGES // 2])
    shown = [seen for seen in report.seen if seen.view in chosen]
    return shown, len(report.seen) - len(shown)


def _caption(seen: Seen, used: np.ndarray, misfit: np.ndarray) -> str:
    name = f"{seen.view}, {seen.device}"
    if seen.found is None:
        return f"{name}: {seen.problem}"
    sharp = f"edges {seen.found.sharpness_px:.2f} px"
    if not len(used):
        return f"{name}: not used, {sharp}"
    return f"{name}: {len(used)} marks, {np.sqrt((misfit**2).sum(axis=1).mean()):.3f} px rms, {sharp}"


def _all(solution: Solution, device: str) -> tuple[np.ndarray, np.ndarray]:
    chosen = [r for (_, name), r in solution.residuals.items() if name == device]
    if not chosen:
        return _EMPTY, _EMPTY
    return np.concatenate([r.pixels for r in chosen]), np.concatenate([r.misfit for r in chosen])


def _common_scale(solution: Solution) -> float:
    width = max(device.size[0] for device in solution.devices.values())
    return vector_scale([r.misfit for r in solution.residuals.values()], width)


def _rounded(value: float, sigma: float, sign: str = "") -> str:
    """A value to a tenth of its standard deviation."""
    if not sigma > 0:
        return f"{value:{sign}.6g}"
    return f"{value:{sign}.{max(0, min(12, 1 - int(np.floor(np.log10(sigma)))))}f}"
