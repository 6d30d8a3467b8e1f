"""The geometric calibration from views of a board: detection, bundle adjustment, checks, report and file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from daemon.apps.calibration.report.report import Report, report_html
from daemon.apps.calibration.solve.archive import StoredCalibration, keep_dated, reject_worse, store
from daemon.apps.calibration.solve.keep_colors import with_old_colors
from daemon.apps.calibration.solve.projector_check import check_projector
from daemon.apps.calibration.views.detect_marks import DetectedViews, detect_views, require_views
from daemon.apps.calibration.views.detect_projector_marks import detect_views_with_projector
from daemon.apps.calibration.views.view import Progress, Source
from daemon.common.files import write_atomically
from daemon.rig.calibration_file import CamerasFile
from daemon.rig.camera_serials import Serials, common_serials
from pipeline.calibrate.bundle import Options, Solution, calibrate
from pipeline.calibrate.bundle.quality.layout_recommendations import layout_recommendations
from pipeline.calibrate.bundle.quality.solution_figures import quality_of
from pipeline.calibrate.bundle.quality.view_assessment import assess_views
from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import CalibrationError, TargetError
from pipeline.rig.calibration import Cameras


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """A calibrated rig that is not written yet.

    Args:
        cameras: with the projector if it was calibrated; solution: with residuals and standard deviations.
        board, sources: the input; detected: its detected marks.
        quality: for the file; notes, advice: sentences about the calibration and about improvements.
        coverage: share of each device's image with marks; before: the file for comparison.
        serials: of the cameras, where the images name them.
    """

    cameras: Cameras
    solution: Solution
    board: Board
    sources: Sequence[str]
    detected: DetectedViews
    quality: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    coverage: dict[str, float] = field(default_factory=dict)
    before: CamerasFile | None = None
    serials: Serials = field(default_factory=dict)


def calibrate_sources(
    board: Board,
    sources: Sequence[Source],
    progress: Progress,
    *,
    fringes: bool,
    options: Options | None = None,
    before: CamerasFile | None = None,
) -> CalibrationResult:
    """Calibrate both cameras from images of a board; with ``fringes`` also the projector, from the sources' sequences.

    Raises:
        SourceError, TargetError, CalibrationError: the problem of the images, and the remedy.
    """
    serials = common_serials((source.name, source.serials) for source in sources)
    detected = (detect_views_with_projector if fringes else detect_views)(sources, board, progress)
    result = calibrate_views(board, detected, [source.name for source in sources], options=options, before=before)
    return replace(result, serials=serials)


def calibrate_views(
    board: Board,
    detected: DetectedViews,
    sources: Sequence[str],
    *,
    options: Options | None = None,
    before: CamerasFile | None = None,
) -> CalibrationResult:
    """Adjust the devices in ``detected.sizes`` jointly, and collect what the file and the report state."""
    options = options or Options()
    require_views(detected, options.least_views)
    absent = {"left", "right"} - detected.sizes.keys()
    if absent:
        raise TargetError(f"no images of the {min(absent)} camera, a rig has two cameras")
    try:
        solution = calibrate(board, detected.views, detected.sizes, options=options)
    except CalibrationError as error:
        raise CalibrationError(f"{', '.join(sources)}: {error}{_undetected(detected)}") from error
    devices = solution.devices
    cameras = Cameras(devices["left"], devices["right"], projector=devices.get("projector"))
    cameras, notes = with_old_colors(cameras, before)
    assessment = assess_views(board, detected.views, detected.sizes, solution=solution)
    quality = quality_of(solution, board=str(board), coverage=assessment.coverage)
    quality["pictures_without_marks"] = len(detected.problems)
    if cameras.projector is not None and detected.phases:
        cameras = _checked_by_all_pixels(cameras, detected, quality, notes)
    layout, figures = layout_recommendations(cameras, solution)
    quality |= figures
    advice = [f"add {lack}" for lack in assessment.missing]
    if advice:
        advice.append(f"the most useful additional pose: {assessment.next_pose.text}")
    notes += _board_notes(solution, options)
    return CalibrationResult(
        cameras, solution, board, sources, detected, quality, notes, advice + layout, assessment.coverage, before
    )


def _checked_by_all_pixels(
    cameras: Cameras, detected: DetectedViews, quality: dict[str, Any], notes: list[str]
) -> Cameras:
    """Check the projector by all pixels of some views; the residual is added to ``quality`` and ``notes``."""
    check = check_projector(cameras.complete(), detected.phases)
    if check is None:
        return cameras
    quality["trinocular_px"] = round(check.residual_px, 4)
    notes.append(check.note)
    return replace(cameras, projector=check.calibration.projector)


def finish(
    result: CalibrationResult, out: Path, report: Path | None, *, force: bool = False, title: str = "Calibration"
) -> StoredCalibration:
    """Write the calibration and its report; the previous files are kept under their dates.

    Raises:
        KeptError: the existing calibration is better; no file was changed.
    """
    created = datetime.now(UTC)
    quality = result.quality | ({"report": report.name} if report is not None else {})
    data = None if report is None else html(result, title=title, created=created)
    reject_worse(out, result.cameras, quality=quality, force=force)
    if report is not None and data is not None:
        if report.exists():
            keep_dated(report, result.before)
        write_atomically(report, data)
    return store(out, result.cameras, quality=quality, force=force, created=created, serials=result.serials)


def html(result: CalibrationResult, *, title: str, created: datetime) -> bytes:
    """The report as HTML."""
    before, created_before = result.before, ""
    if before is not None:
        created_before = str(before.mapping.get("created", "without a date"))
    return report_html(
        Report(
            title=title,
            created=created,
            board=str(result.board),
            sources=result.sources,
            solution=result.solution,
            images=result.detected.images,
            cameras=result.cameras,
            coverage=result.coverage,
            before=None if before is None else before.cameras,
            before_name=created_before,
            notes=result.notes,
            advice=result.advice,
            problems=result.detected.left_out,
        )
    )


def _undetected(detected: DetectedViews) -> str:
    count = len(detected.problems)
    if not count:
        return ""
    first = detected.problems[0]
    return (
        f" (no marks were detected in {count} of {len(detected.images)} images, such as {first.file}: {first.problem})"
    )


def _board_notes(solution: Solution, options: Options) -> list[str]:
    if not options.board_refined:
        return []
    points = solution.board_points
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    beside = points[:, 2] - plane @ np.linalg.lstsq(plane, points[:, 2], rcond=None)[0]
    return [
        f"the marks' positions on the board were estimated too; they lie within {np.abs(beside).max():.3f} mm of a "
        "plane"
    ]
