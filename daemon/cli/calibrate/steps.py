"""``fringed calibrate cameras``, ``projector``, ``color`` and ``all``: from images, or live with a rig.yaml."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from daemon.cli.calibrate.board import BOARD_HELP

if TYPE_CHECKING:
    from daemon.apps.calibration.guided.rerun_view import Kind as ViewKind
    from daemon.apps.calibration.guided.run_session import Step
    from daemon.apps.calibration.solve.archive import StoredCalibration
    from daemon.apps.calibration.solve.solve import CalibrationResult
    from daemon.apps.calibration.views.view import Source
    from daemon.rig.calibration_file import CamerasFile
    from pipeline.calibrate.bundle import Options

Rig = Annotated[Path | None, typer.Argument(help="Live: the rig.yaml. Without it, the options name images.")]
Left = Annotated[str | None, typer.Option(help="Images of the left camera, such as 'L/*.png', sorted by name.")]
Right = Annotated[str | None, typer.Option(help="Images of the right camera, paired by their order.")]
Views = Annotated[list[Path] | None, typer.Option(help="Capture folder or take; may be given several times.")]
BoardText = Annotated[str, typer.Option("--board", help=BOARD_HELP)]
Out = Annotated[Path, typer.Option("--out", help="Write the calibration here; a replaced file is kept.")]
ReportFile = Annotated[
    Path | None, typer.Option("--report", help="Write the report here.", show_default="beside --out")
]
Force = Annotated[bool, typer.Option("--force", help="Replace a better calibration too.")]
FreeSkew = Annotated[bool, typer.Option("--skew/--no-skew", help="Estimate the skew of the pixel axes.")]
FreeK3 = Annotated[bool, typer.Option("--k3/--no-k3", help="Estimate the third radial coefficient.")]
Refine = Annotated[bool, typer.Option("--refine-board", help="Estimate the marks' positions on the board too.")]
Distance = Annotated[
    str | None, typer.Option("--distance", help="Scale from a distance on the board: MARK-MARK:MM such as 0-98:409.2.")
]
Poses = Annotated[int, typer.Option(min=3, help="Live: least number of poses of the board.")]
Show = Annotated[Literal["none", "web", "native"], typer.Option("--view", help="Live: a view in Rerun.")]
Session = Annotated[Path | None, typer.Option(help="Live: folder for the images.", show_default="beside rig.yaml")]

DEFAULT_BOARD = "circles:11x9:32:20"
DEFAULT_OUT = Path("calibration.yaml")


def cameras(
    rig: Rig = None,
    left: Left = None,
    right: Right = None,
    views: Views = None,
    board: BoardText = DEFAULT_BOARD,
    out: Out = DEFAULT_OUT,
    report: ReportFile = None,
    force: Force = False,
    skew: FreeSkew = True,
    k3: FreeK3 = True,
    refine_board: Refine = False,
    distance: Distance = None,
    poses: Poses = 12,
    view: Show = "none",
    session: Session = None,
) -> None:
    """Calibrate both cameras together, from images of a board in ten or more poses."""
    _step("cameras", **locals())


def projector(
    rig: Rig = None,
    views: Views = None,
    left: Left = None,
    right: Right = None,
    board: BoardText = DEFAULT_BOARD,
    out: Out = DEFAULT_OUT,
    report: ReportFile = None,
    force: Force = False,
    skew: FreeSkew = True,
    k3: FreeK3 = True,
    refine_board: Refine = False,
    distance: Distance = None,
    poses: Poses = 12,
    view: Show = "none",
    session: Session = None,
) -> None:
    """Calibrate projector and cameras together, from fringes in both directions on a board in ten or more poses.

    Views without fringes (--left and --right, or another --views) contribute to the cameras.
    """
    _step("projector", **locals())


def color(
    rig: Rig = None,
    views: Views = None,
    calibration: Annotated[Path, typer.Option(help="The calibration that gets the colours.")] = DEFAULT_OUT,
    out: Annotated[Path | None, typer.Option(help="Write here instead.", show_default="--calibration")] = None,
    board: Annotated[str, typer.Option("--board", help="Live: the board. " + BOARD_HELP)] = DEFAULT_BOARD,
    force: Force = False,
    poses: Poses = 12,
    view: Show = "none",
    session: Session = None,
) -> None:
    """Calibrate black level, crosstalk, lateral colour and the projector's response, from a white board at rest."""
    if rig is not None:
        return _live(
            "color", rig, None, None, views, board=board, poses=poses, view=view, session=session,
            calibration=calibration, out=out, force=force,
        )  # fmt: skip
    from daemon.apps.calibration.solve.color import calibrate_colors
    from daemon.cli.options.progress import rendering

    sources = _sources(None, None, views)
    with rendering("Reading images") as progress:
        result = calibrate_colors(calibration, sources, progress)
    stored = result.write(out or calibration, force=force)
    _print_stored(stored, [*result.summary, *result.advice])
    return None


def everything(
    rig: Rig = None,
    views: Views = None,
    left: Left = None,
    right: Right = None,
    board: BoardText = DEFAULT_BOARD,
    out: Out = DEFAULT_OUT,
    report: ReportFile = None,
    force: Force = False,
    skew: FreeSkew = True,
    k3: FreeK3 = True,
    refine_board: Refine = False,
    distance: Distance = None,
    poses: Poses = 12,
    view: Show = "none",
    session: Session = None,
) -> None:
    """Calibrate cameras, projector and colours: --views for the board with fringes, and --views for the colours."""
    _step("all", **locals())


def _step(
    step: Step, *, rig: Path | None, left: str | None, right: str | None, views: list[Path] | None, **options: Any
) -> None:
    """Run a geometric step, live or from images; ``options`` are the command's other arguments by name."""
    if rig is not None:
        _live(step, rig, left, right, views, **options)
        return
    adjustment = _options(options["skew"], options["k3"], options["refine_board"], options["distance"])
    _geometry(
        step, _sources(left, right, views), options["board"], options["out"], options["report"], options["force"],
        adjustment,
    )  # fmt: skip


def _geometry(
    step: str, sources: list[Source], text: str, out: Path, report: Path | None, force: bool, options: Options
) -> None:
    from daemon.apps.calibration.solve import solve
    from daemon.apps.calibration.solve.color import is_color, with_colors
    from daemon.cli.options.progress import rendering
    from pipeline.calibrate.targets.board.board import parse_board

    board = parse_board(text)
    before = _before(out, force)
    colors = [source for source in sources if step == "all" and is_color(source.sequence)]
    boards = [source for source in sources if source not in colors]
    if step == "all" and (not colors or not boards):
        lacking = "colours (sequence 'color')" if not colors else "the board (sequence 'projector')"
        raise typer.BadParameter(f"no --views for {lacking}; `all` requires both")
    with rendering("Detecting marks") as progress:
        result = solve.calibrate_sources(
            board, boards, progress, fringes=step != "cameras", options=options, before=before
        )
    if colors:
        with rendering("Reading colours") as progress:
            result = with_colors(result, colors, progress)
    title = {"cameras": "Calibration of the cameras", "projector": "Calibration of cameras and projector"}
    report = report or out.with_name(f"{out.stem}.report.html")
    stored = solve.finish(result, out, report, force=force, title=title.get(step, "Calibration of the rig"))
    _summary(result)
    _print_stored(stored, [*result.notes, *result.advice])
    typer.echo(f"report: {report}")


def _before(out: Path, force: bool) -> CamerasFile | None:
    from daemon.apps.calibration.solve.archive import existing
    from pipeline.common.errors import CalibrationError

    try:
        return existing(out)
    except CalibrationError:
        if not force:
            raise
        return None


def _summary(result: CalibrationResult) -> None:
    s = result.solution
    for rejection in s.rejected:
        typer.echo(f"{'repaired' if rejection.repaired else 'left out'}: {rejection}", err=True)
    for image in result.detected.problems:
        typer.echo(f"left out: {image.file}: {image.problem}", err=True)
    for problem in result.detected.left_out:
        typer.echo(f"left out: {problem}", err=True)
    rms = ", ".join(f"{name} {value:.3f}" for name, value in s.rms.items())
    typer.echo(
        f"{s.views_used} views used, {s.views_rejected} left out; reprojection error {rms} px rms, epipolar error "
        f"{s.epipolar_px:.3f} px; baseline {s.baseline_mm:.3f} ± {s.sigma.get('baseline_mm', 0):.2g} mm"
    )


def _print_stored(stored: StoredCalibration, notes: list[str]) -> None:
    for note in [*notes, *stored.notes]:
        typer.echo(f"note: {note}", err=True)
    typer.echo(f"{stored.path}: {stored.identity}")
    if stored.kept is not None:
        typer.echo(f"the previous file is kept as {stored.kept}")


def _sources(left: str | None, right: str | None, views: list[Path] | None) -> list[Source]:
    from daemon.apps.calibration.views.open_source import ImagePairs, open_source

    if (left is None) != (right is None):
        raise typer.BadParameter("--left and --right belong together")
    sources: list[Source] = [open_source(path) for path in views or ()]
    if left is not None and right is not None:
        sources.append(ImagePairs(left, right))
    if not sources:
        raise typer.BadParameter("give a rig.yaml to calibrate live, or images: --left and --right, or --views")
    return sources


def _options(skew: bool, k3: bool, refine_board: bool, distance: str | None) -> Options:
    import re

    from pipeline.calibrate.bundle import Options

    distance_mm = None
    if distance is not None:
        match = re.fullmatch(r"(\d{1,4})-(\d{1,4}):(\d+(?:\.\d+)?)", distance)
        if match is None:
            raise typer.BadParameter(f"--distance {distance}: expected two marks and mm, such as 0-98:409.2")
        distance_mm = (int(match[1]), int(match[2]), float(match[3]))
    return Options(skew=skew, k3=k3, board_refined=refine_board, known_distance=distance_mm)


def _live(
    step: Step,
    rig: Path,
    left: str | None,
    right: str | None,
    views: list[Path] | None,
    *,
    board: str,
    poses: int,
    view: ViewKind,
    session: Path | None,
    **options: Any,
) -> None:
    if left or right or views:
        raise typer.BadParameter(
            "a rig.yaml calibrates live, --left, --right and --views from images: give one of them"
        )
    from daemon.cli.calibrate.guided import run

    command: Any = {"cameras": cameras, "projector": projector, "color": color, "all": everything}[step]

    def solve(folders: list[Path]) -> None:
        command(views=folders, board=board, **options)

    run(step, rig, solve, board=board, poses=poses, view=view, session=session)
