"""The steps of a calibration on views that were looked at, without any command line; live sessions call them too."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from daemon.apps.calibration.report.report import Report, report_html
from daemon.apps.calibration.solve.archive import Stored, better_reasons, keep_dated, refuse_worse, store
from daemon.apps.calibration.solve.keep_colors import with_old_colors
from daemon.apps.calibration.solve.projector_check import last_look
from daemon.apps.calibration.views.detect_marks import Looked, look, require
from daemon.apps.calibration.views.detect_projector_marks import look_with_projector
from daemon.apps.calibration.views.view import Progress, Source
from daemon.common.files import write_atomically
from daemon.rig.calibration_file import CamerasFile
from pipeline.calibrate.bundle import Options, Solution, calibrate
from pipeline.calibrate.bundle.quality.order_check import layout_recommendations
from pipeline.calibrate.bundle.quality.solution_figures import quality_of
from pipeline.calibrate.bundle.quality.view_assessment import assess_views
from pipeline.calibrate.targets.board.board import Board
from pipeline.common.errors import CalibrationError, TargetError
from pipeline.rig.calibration import Cameras

__all__ = ["Calibrated", "Report", "Stored", "better_reasons", "calibrated", "finish", "solved"]


@dataclass(frozen=True, slots=True, eq=False)
class Calibrated:
    """A rig that was calibrated and is not written yet.

    Args:
        cameras: with the projector, if that was a part of it; solution: with residuals and standard deviations.
        board, sources: what was looked at; looked: what was seen.
        quality: for the file; notes: what was done; advice: what would make it better; sentences.
        coverage: share of each device's image that saw marks; before: the file that it is compared with.
    """

    cameras: Cameras
    solution: Solution
    board: Board
    sources: Sequence[str]
    looked: Looked
    quality: dict[str, Any]
    notes: list[str] = field(default_factory=list)
    advice: list[str] = field(default_factory=list)
    coverage: dict[str, float] = field(default_factory=dict)
    before: CamerasFile | None = None


def solved(
    board: Board,
    sources: Sequence[Source],
    progress: Progress,
    *,
    fringes: bool,
    options: Options | None = None,
    before: CamerasFile | None = None,
) -> Calibrated:
    """Both cameras from images of a board; with ``fringes`` the projector too, from the sequences among the sources.

    Raises:
        SourceError, TargetError, CalibrationError: what is wrong with the images, and what to do.
    """
    looked = (look_with_projector if fringes else look)(sources, board, progress)
    return calibrated(board, looked, [source.name for source in sources], options=options, before=before)


def calibrated(
    board: Board,
    looked: Looked,
    sources: Sequence[str],
    *,
    options: Options | None = None,
    before: CamerasFile | None = None,
) -> Calibrated:
    """The joint adjustment of the devices in ``looked.sizes``, with everything that the file and the report say."""
    options = options or Options()
    require(looked, options.least_views)
    absent = {"left", "right"} - looked.sizes.keys()
    if absent:
        raise TargetError(f"no images of the {min(absent)} camera: a rig has two")
    try:
        solution = calibrate(board, looked.views, looked.sizes, options=options)
    except CalibrationError as error:
        raise CalibrationError(f"{', '.join(sources)}: {error}{_not_found(looked)}") from error
    devices = solution.devices
    found = Cameras(devices["left"], devices["right"], projector=devices.get("projector"))
    found, notes = with_old_colors(found, before)
    wanted = assess_views(board, looked.views, looked.sizes, solution=solution)
    quality = quality_of(solution, board=str(board), coverage=wanted.coverage)
    quality["pictures_without_marks"] = len(looked.problems)
    if found.projector is not None and looked.phases:
        found = _looked_at_again(found, looked, quality, notes)
    layout, figures = layout_recommendations(found, solution)
    quality |= figures
    advice = [f"add {wish}" for wish in wanted.missing]
    if advice:
        advice.append(f"the pose that would help most: {wanted.next_pose.text}")
    notes += _refined(solution, options)
    return Calibrated(found, solution, board, sources, looked, quality, notes, advice + layout, wanted.coverage, before)


def _looked_at_again(found: Cameras, looked: Looked, quality: dict[str, Any], notes: list[str]) -> Cameras:
    """The projector judged by all pixels of some views; its residual goes into ``quality`` and ``notes``."""
    last = last_look(found.complete(), looked.phases)
    if last is None:
        return found
    quality["trinocular_px"] = round(last.residual_px, 4)
    notes.append(last.note)
    return replace(found, projector=last.calibration.projector)


def finish(
    result: Calibrated, out: Path, report: Path | None, *, force: bool = False, title: str = "Calibration"
) -> Stored:
    """Write the calibration and its report; the ones before stay beside them under their dates.

    Raises:
        KeptError: the calibration in that place is better; nothing was written.
    """
    created = datetime.now(UTC)
    quality = result.quality | ({"report": report.name} if report is not None else {})
    data = None if report is None else html(result, title=title, created=created)
    refuse_worse(out, result.cameras, quality=quality, force=force)
    if report is not None and data is not None:
        if report.exists():
            keep_dated(report, result.before)
        write_atomically(report, data)
    return store(out, result.cameras, quality=quality, force=force, created=created)


def html(result: Calibrated, *, title: str, created: datetime) -> bytes:
    """The report."""
    before, when = result.before, ""
    if before is not None:
        when = str(before.mapping.get("created", "without a date"))
    return report_html(
        Report(
            title=title,
            created=created,
            board=str(result.board),
            sources=result.sources,
            solution=result.solution,
            seen=result.looked.seen,
            cameras=result.cameras,
            coverage=result.coverage,
            before=None if before is None else before.cameras,
            before_name=when,
            notes=result.notes,
            advice=result.advice,
            problems=result.looked.left_out,
        )
    )


def with_colors(result: Calibrated, colors: Cameras, quality: dict[str, Any], notes: list[str]) -> Calibrated:
    """The same with colours that were calibrated together with it."""
    return replace(result, cameras=colors, quality=result.quality | quality, notes=result.notes + notes)


def _not_found(looked: Looked) -> str:
    count = len(looked.problems)
    if not count:
        return ""
    first = looked.problems[0]
    return f" (in {count} of {len(looked.seen)} images no marks were found, as in {first.file}: {first.problem})"


def _refined(solution: Solution, options: Options) -> list[str]:
    if not options.board_refined:
        return []
    points = solution.board_points
    plane = np.column_stack([points[:, :2], np.ones(len(points))])
    beside = points[:, 2] - plane @ np.linalg.lstsq(plane, points[:, 2], rcond=None)[0]
    return [f"the marks' places on the board were found too; they lie within {np.abs(beside).max():.3f} mm of a plane"]
