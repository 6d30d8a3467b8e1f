"""The report of a calibration, section by section."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from html import escape

import numpy as np

from daemon.apps.calibration.report.charts import COLORS, coverage_map, histogram, vector_scale, view_bars, view_image
from daemon.apps.calibration.views.detect_marks import ImageDetection
from daemon.common.html_page import Card, figure, items, page, table
from pipeline.calibrate.bundle import Solution
from pipeline.calibrate.bundle.adjust.state import INTRINSICS, POSE
from pipeline.calibrate.bundle.quality.solution_figures import values_of, view_figures
from pipeline.rig.calibration import Cameras

_EMPTY = np.empty((0, 2))
MOST_IMAGES = 60
"""Most images in a report; each needs some 50 kilobytes."""


@dataclass(frozen=True, slots=True)
class Report:
    """The contents of a report.

    Args:
        title, created, board, sources: for the head of the page.
        solution: with its residuals; images: with their detections.
        coverage: share of each device's image with marks.
        cameras: as written to the file; before: those of the previous file, ``before_name`` its date.
        notes, advice: sentences about the calibration and about improvements.
    """

    title: str
    created: datetime
    board: str
    sources: Sequence[str]
    solution: Solution
    images: Sequence[ImageDetection]
    cameras: Cameras
    coverage: Mapping[str, float]
    before: Cameras | None = None
    before_name: str = ""
    notes: Sequence[str] = field(default_factory=list)
    advice: Sequence[str] = field(default_factory=list)
    problems: Sequence[str] = field(default_factory=list)


def report_html(report: Report) -> bytes:
    """The report as an HTML page, UTF-8."""
    solution = report.solution
    lines = [
        f"{report.created:%d %B %Y, %H:%M} UTC · board {report.board} · {', '.join(report.sources)}",
        f"Scale from {solution.scale}." if solution.scale else "",
    ]
    sections = [
        ("Advice", items(report.advice)),
        ("Notes", items(report.notes)),
        ("Errors by view", _views(solution)),
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
        "Root mean square distance between marks and their predicted positions, and mean distance of the marks from "
        "the "
        "epipolar lines of the other camera. In a view with large errors the board moved, or the images are blurred.",
    )


def _left_out(report: Report) -> str:
    rows = [
        (image.view, image.device, "all marks", image.problem) for image in report.images if image.detection is None
    ]
    for rejection in report.solution.rejected:
        marks = ", ".join(map(str, rejection.ids)) if rejection.ids else "all marks"
        reason = f"{rejection.reason} (repaired, used)" if rejection.repaired else rejection.reason
        rows.append((rejection.view, rejection.device or "all", marks, reason))
    rows += [("", "", "", problem) for problem in report.problems]
    if not rows:
        return "<p>None: every mark of every image was used.</p>"
    return table(("view", "device", "marks", "reason"), rows, text=range(4))


def _coverage(solution: Solution) -> str:
    scale = _common_scale(solution)
    out = []
    for device, model in solution.devices.items():
        pixels, misfit = _all(solution, device)
        out.append(
            figure(
                coverage_map(model.size, pixels, misfit, scale=3 * scale, color=COLORS[device]),
                f"{device}, {model.size[0]} x {model.size[1]} pixels: every mark of every view; red cells have none. "
                f"Arrows: mean residual of a cell, {3 * scale:g} times enlarged.",
            )
        )
    return (
        "<p>The lens model is determined where marks were detected. Arrows with a common pattern show an unsuitable "
        f'lens model; arrows without a pattern are noise.</p><div class="pair">{"".join(out)}</div>'
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
                "line: v, dashed: normal distribution of this width.",
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
        "<p>Standard deviations from the residuals and the geometry of all views together. fx, fy, skew, cx, cy in "
        "pixels; rotations as a rotation vector in radians; translations in mm.</p>"
    )
    if before:
        text += (
            f"<p>Before: {escape(report.before_name)}. Red: changed by more than five standard deviations; a "
            "device was moved, refocused or replaced.</p>"
        )
    wide = " wide" if before else ""
    return f'{text}<div class="tables{wide}">{"".join(tables)}</div>'


def _table(report: Report, before: Mapping[str, float], heading: str, names: Sequence[tuple[str, str]]) -> str:
    """Values and standard deviations of some parameters, (name, label), beside the previous ones."""
    rows: list[list[str]] = []
    out: list[int] = []
    for name, label in names:
        value, sigma = report.solution.values.get(name), report.solution.sigma.get(name, 0.0)
        if value is None:
            continue
        row = [label, _rounded(value, sigma), f"{sigma:.2g}" if sigma > 0 else "held"]
        previous = before.get(name)
        if before:
            change = None if previous is None else value - previous
            row += ["", ""] if change is None else [_rounded(value - change, sigma), _rounded(change, sigma, sign="+")]
            ratio = abs(change) / sigma if change is not None and sigma > 0 else None
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
    for image in shown:
        residuals = report.solution.residuals.get((image.view, image.device))
        used, misfit = (residuals.pixels, residuals.misfit) if residuals is not None else (_EMPTY, _EMPTY)
        left_out = _EMPTY
        if image.detection is not None:
            marks = image.detection.marks
            accepted = np.isin(marks.ids, residuals.ids) if residuals is not None else np.zeros(len(marks), np.bool_)
            left_out = marks.pixels[~accepted] if residuals is None or len(used) < len(marks) else _EMPTY
        svg = view_image(image.size, image.thumbnail, used, misfit, left_out, scale=scale, color="#35d07f")
        out.append(figure(svg, _caption(image, used, misfit)))
    text = f"Green: used marks; red lines: residuals, {scale:g} times enlarged; amber crosses: marks left out."
    text += f" The worst views are shown, {rest} images are omitted." if rest else ""
    return f'<p>{text}</p><div class="grid">{"".join(out)}</div>'


def _worst(report: Report) -> tuple[list[ImageDetection], int]:
    """The images to show, in order: all of them, or those of the worst views; and the number of omitted images."""
    if len(report.images) <= MOST_IMAGES:
        return list(report.images), 0
    errors = {view.name: max(view.rms.values(), default=np.inf) for view in view_figures(report.solution)}
    views = sorted({image.view for image in report.images}, key=lambda name: -errors.get(name, np.inf))
    chosen = set(views[: MOST_IMAGES // 2])
    shown = [image for image in report.images if image.view in chosen]
    return shown, len(report.images) - len(shown)


def _caption(image: ImageDetection, used: np.ndarray, misfit: np.ndarray) -> str:
    name = f"{image.view}, {image.device}"
    if image.detection is None:
        return f"{name}: {image.problem}"
    sharp = f"edges {image.detection.sharpness_px:.2f} px"
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
    """Round a value to a tenth of its standard deviation."""
    if not sigma > 0:
        return f"{value:{sign}.6g}"
    return f"{value:{sign}.{max(0, min(12, 1 - int(np.floor(np.log10(sigma)))))}f}"
