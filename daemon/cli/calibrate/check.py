"""``fringed calibrate check``: the accuracy of a calibration, from a view of a board or of a known length."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from daemon.cli.calibrate.board import BOARD_HELP

if TYPE_CHECKING:
    from pipeline.calibrate.length_check import Distances, Limits
    from pipeline.rig.calibration import Cameras


def main(
    left: Annotated[str, typer.Option(help="Image of the left camera, or several such as 'L/*.png'.")],
    right: Annotated[str, typer.Option(help="Images of the right camera, as many.")],
    calibration: Annotated[Path, typer.Option(help="The calibration to check.")] = Path("calibration.yaml"),
    board: Annotated[str | None, typer.Option(help=BOARD_HELP)] = None,
    length: Annotated[
        float | None, typer.Option(min=1e-3, help="mm between two circles, the only ones visible.")
    ] = None,
    limit_ppm: Annotated[float, typer.Option(min=0.0, help="Largest scale error.")] = 500.0,
    limit_mm: Annotated[float, typer.Option(min=0.0, help="Largest error of a distance.", show_default="0.1 %")] = 0.0,
    limit_px: Annotated[float, typer.Option(min=0.0, help="Largest epipolar error, rms.")] = 0.5,
    as_json: Annotated[bool, typer.Option("--json", help="Print plain JSON.")] = False,
) -> None:
    """Measure known distances with a calibration; the exit status is 1 if an error exceeds its limit."""
    import json
    from dataclasses import asdict

    from daemon.rig.calibration_file import read_cameras
    from pipeline.calibrate.length_check import Limits

    if (board is None) == (length is None):
        raise typer.BadParameter("give either --board or --length")
    cameras = read_cameras(calibration).cameras
    limits = Limits(limit_ppm, limit_mm, limit_px)
    results = (
        _board(cameras, left, right, board, limits) if board else _bar(cameras, left, right, length or 0.0, limits)
    )
    if as_json:
        typer.echo(json.dumps([{"view": name} | asdict(one) for name, one in results], indent=2))
    else:
        for name, one in results:
            _print(name, one)
    if any(one.complaints for _, one in results):
        raise typer.Exit(1)


def _board(cameras: Cameras, left: str, right: str, text: str, limits: Limits) -> list[tuple[str, Distances]]:
    from daemon.apps.calibration.views.detect_marks import detect_views, require_views
    from daemon.apps.calibration.views.open_source import ImagePairs
    from daemon.cli.options.progress import rendering
    from pipeline.calibrate.length_check import check_board
    from pipeline.calibrate.targets.board.board import parse_board
    from pipeline.common.errors import TargetError

    board = parse_board(text)
    with rendering("Detecting marks") as progress:
        detected = detect_views([ImagePairs(left, right)], board, progress)
    require_views(detected, 1)
    _same_size(cameras, detected.sizes, left, right)
    if detected.problems:
        first = detected.problems[0]
        raise TargetError(f"{first.file}: {first.problem}")
    views = [(view.name, view.marks["left"], view.marks["right"]) for view in detected.views]
    return [(name, check_board(cameras, board, a, b, limits)) for name, a, b in views]


def _bar(cameras: Cameras, left: str, right: str, length: float, limits: Limits) -> list[tuple[str, Distances]]:
    from daemon.apps.calibration.images.image_files import demosaic
    from daemon.apps.calibration.views.open_source import ImagePairs
    from daemon.cli.options.progress import rendering
    from pipeline.calibrate.length_check import check_length
    from pipeline.calibrate.targets.scale_bar import two_circles

    results = []
    with rendering("Detecting circles") as progress:
        for view in ImagePairs(left, right).views(progress):
            ends, sizes = [], {}
            for device, file, images in zip(("left", "right"), view.files, (view.left, view.right), strict=True):
                image = demosaic(images[0], view.encoding)
                sizes[device] = image.shape[1::-1]
                ends.append(two_circles(image, file))
            _same_size(cameras, sizes, *view.files)
            results.append((view.name, check_length(cameras, length, ends[0], ends[1], limits)))
    return results


def _same_size(cameras: Cameras, sizes: dict[str, tuple[int, int]], left: str, right: str) -> None:
    from daemon.common.errors import DaemonError

    for device, name, size in (("left", left, cameras.left.size), ("right", right, cameras.right.size)):
        if device in sizes and tuple(sizes[device]) != size:
            width, height = sizes[device]
            raise DaemonError(
                f"{name}: {width} x {height} pixels, but the {device} camera was calibrated with {size[0]} x {size[1]}"
            )


def _print(name: str, distances: Distances) -> None:
    good = "good" if not distances.complaints else "OUT"
    if distances.pairs == 1:
        typer.echo(f"{name}: {good}: {distances.longest_mm:g} mm measured with {distances.mean_mm:+.4f} mm", nl=False)
        typer.echo(f" ({distances.scale_ppm:+.0f} ppm); epipolar error {distances.epipolar_px:.3f} px rms")
    else:
        a, b = distances.worst
        typer.echo(
            f"{name}: {good}: {distances.pairs} distances between {distances.marks} marks up to "
            f"{distances.longest_mm:.0f} mm: "
            f"mean {distances.mean_mm:+.4f} mm, rms {distances.rms_mm:.4f} mm, worst {distances.worst_mm:+.4f} mm "
            f"(marks {a} and {b}); scale {distances.scale_ppm:+.0f} ppm; flat within {distances.flatness_mm:.4f} mm "
            "rms; "
            f"epipolar error {distances.epipolar_px:.3f} px rms"
        )
    for complaint in distances.complaints:
        typer.echo(f"{name}: {complaint}", err=True)
