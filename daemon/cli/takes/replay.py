"""``fringed replay``: reconstruct a recorded take, write its clouds, and compare them with a golden file."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast, get_args

import typer
from typer.core import TyperCommand

from daemon.cli.options.parts_option import PartsOption, chosen_parts

if TYPE_CHECKING:
    from daemon.apps.replay.golden import Deviation, Golden, PairStatistics
    from daemon.apps.replay.reconstruct_item import Run
    from daemon.apps.replay.runner import Replay, Result

_VIEWER = "viewer"
INCONSISTENT = 3
"""Exit status of a replay with pairs that contradict the calibration."""


class ReplayCommand(TyperCommand):
    """``--rerun`` with or without the name of a ``.rrd`` file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Add the value of a ``--rerun`` without a file."""
        completed: list[str] = []
        for argument, following in zip(args, [*args, ""][1:], strict=True):
            completed.append(argument)
            if argument == "--rerun" and not following.endswith(".rrd"):
                completed.append(_VIEWER)
        return super().parse_args(ctx, completed)


app = typer.Typer(add_completion=False, rich_markup_mode=None)


@app.command(cls=ReplayCommand)
def main(
    take: Annotated[Path, typer.Argument(help="The take: its first file, or one of its parts.")],
    out: Annotated[Path | None, typer.Option(help="Directory for clouds and summary.json.")] = None,
    no_output: Annotated[
        bool, typer.Option("--no-output", help="Write only summary.json (here, if no --out).")
    ] = False,
    repeat: Annotated[int, typer.Option(min=1, max=10000, help="Number of reconstructions of every pair.")] = 1,
    kind: Annotated[
        str, typer.Option("--format", help="Kind of cloud files: npz, ply, pcd, or meshes: mesh.ply, glb.")
    ] = "npz",
    parts: PartsOption = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration instead of the attached one.")] = None,
    preset: Annotated[
        str, typer.Option(help="Settings and temporal fusion of a preset; own ones are in presets/ here.")
    ] = "balanced",
    set_: Annotated[
        list[str] | None, typer.Option("--set", help="Change a setting: key=value. May be repeated.")
    ] = None,
    threads: Annotated[int, typer.Option(min=0, max=256, help="Worker threads; 0 = all.")] = 0,
    use_prior: Annotated[
        bool, typer.Option("--follow", help="Use the previous pair as temporal prior, as in a live run.")
    ] = False,
    calibration_check: Annotated[
        str, typer.Option(help="Pairs that contradict the calibration: withhold their points, warn, or off.")
    ] = "withhold",
    temporal: Annotated[
        Literal["off", "fuse"] | None,
        typer.Option(help="Average clouds where the scene is at rest. Default: as the preset.", show_default=False),
    ] = None,
    frame: Annotated[Path | None, typer.Option(help="Pose file of the frame of the clouds.")] = None,
    rerun: Annotated[str | None, typer.Option(metavar="[FILE.rrd]", help="Show the clouds, or save for Rerun.")] = None,
    expect: Annotated[
        Path | None, typer.Option(help="Compare with this golden file; exit status 1 for deviations.")
    ] = None,
    bless: Annotated[Path | None, typer.Option(help="Write this golden file from the results.")] = None,
) -> None:
    """Reconstruct a recorded take.

    The same take gives bit-identical clouds on the same machine, with any number of threads. A truncated take
    is replayed up to the cut. To measure the speed: --no-output --repeat 100. Exit status 3: pairs contradict the
    calibration, and their clouds have no points.
    """
    from daemon.apps.export.cloud_files import KINDS
    from daemon.apps.replay import golden
    from daemon.apps.replay.runner import Replay
    from daemon.cli.options.set_option import parsed_settings
    from daemon.common.errors import InputError
    from daemon.config.presets import read_preset
    from daemon.recording.read.take_reader import TakeReader
    from daemon.rig.pose_file import read_pose
    from pipeline.monitor.check.checked_reconstructor import Policy

    if kind not in KINDS:
        raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(KINDS)}")
    chosen = chosen_parts(parts)
    if rerun is None and expect is None and bless is None and out is None:
        if not no_output:
            raise InputError("no destination for the clouds: give --out DIR, --rerun, --expect FILE or --bless FILE")
        out = Path()
    if calibration_check not in get_args(Policy):
        raise InputError(
            f"--calibration-check is {calibration_check!r}, expected one of: {', '.join(get_args(Policy))}"
        )
    values = read_preset(preset, Path())
    temporal = temporal or values.get("temporal", "off")
    if temporal == "fuse" and repeat > 1:
        raise InputError(f"--temporal fuse averages with the clouds before, and --repeat {repeat} repeats a pair")
    expected = golden.load(expect) if expect is not None else None
    cell = _cell(expected, bless)
    with TakeReader(take) as reader:
        settings = parsed_settings(set_ or [], values)
        replay = Replay(reader, settings=settings, threads=threads, calibration=calibration, use_prior=use_prior)
        replay.calibration_check = cast(Policy, calibration_check)
        replay.parts = chosen or ()
        replay.pose, replay.fuse = None if frame is None else read_pose(frame), temporal == "fuse"
        runs, figures = _replay(replay, None if no_output else out, kind, repeat, rerun, cell)
        _report(replay, runs, out)
        if bless is not None:
            _bless(bless, figures, replay)
        if expected is not None and not _matches(expected, figures):
            raise typer.Exit(1)
        _report_consistency(replay, runs)


def _report_consistency(replay: Replay, runs: list[Run]) -> None:
    """Print contradictions to the calibration; exit with status 3 if clouds were withheld."""
    bad = [run for run in runs if run.consistency is not None and run.consistency["verdict"] == "inconsistent"]
    if not bad:
        return
    withheld = replay.calibration_check == "withhold"
    consequence = ": their clouds have no points" if withheld else ""
    reason = (bad[0].consistency or {}).get("reason", "")
    typer.echo(
        f"{len(bad)} of {len(runs)} reconstructions contradict the calibration{consequence}. First: pair "
        f"{bad[0].sequence}: {reason}. Calibrate the rig again, or give the calibration of its present state by "
        "--calibration.",
        err=True,
    )
    if withheld:
        raise typer.Exit(INCONSISTENT)


def _cell(expected: Golden | None, bless: Path | None) -> int:
    """Size of the golden grid's cells, as in the compared or replaced file."""
    from daemon.apps.replay import golden

    if expected is not None:
        return expected.cell
    return golden.load(bless).cell if bless is not None and bless.exists() else golden.CELL


def _replay(
    replay: Replay, out: Path | None, kind: str, repeat: int, rerun: str | None, cell: int
) -> tuple[list[Run], list[PairStatistics]]:
    """Reconstruct every pair; write, show and evaluate each cloud."""
    from daemon.apps.replay.golden import statistics
    from daemon.cli.options.progress import rendering
    from daemon.cli.takes.replay_directory import ReplayDirectory

    runs: list[Run] = []
    figures: list[PairStatistics] = []
    size = replay.take.size
    target = ReplayDirectory(out, replay.take.path) if out is not None else None
    with ExitStack() as stack:
        show = _viewer(rerun, stack, "rgb" if "rgb" in replay.parts else "depth") if rerun is not None else None
        compiling = stack.enter_context(rendering("Compiling the kernels"))
        replay.compiling = lambda jobs: compiling(*jobs) if jobs.done < jobs.total else None
        progress = stack.enter_context(rendering(f"Replaying {replay.take.path.name}"))
        for result in replay.results(repeat=repeat, progress=lambda position: progress(position, size)):
            runs.extend(result.runs)
            figures.append(statistics(result.pair.sequence, result.cloud.xyz[..., 2], result.cloud.sigma_mm, cell))
            if target is not None:
                target.write(kind, result, replay.parts or None)
            if show is not None:
                show(result)
        progress(size, size)
    if target is not None:
        target.begin()  # also without any cloud
        if target.removed:
            typer.echo(f"{out}: {target.removed} clouds of an earlier replay removed", err=True)
    return runs, figures


def _viewer(rerun: str, stack: ExitStack, color: str) -> Callable[[Result], None]:
    from daemon.apps.replay.rerun_log import RerunLog

    log = RerunLog(None if rerun == _VIEWER else Path(rerun), color=color)

    def end(kind: type[BaseException] | None, _: object, __: object) -> None:
        if kind is None:
            log.close()
        else:
            log.discard()

    stack.push(end)
    return log.show


def _report(replay: Replay, runs: list[Run], out: Path | None) -> None:
    """Write summary.json and print the results; DaemonError without any cloud."""
    from daemon.apps.replay.summary import summary_of, write_summary
    from daemon.common.errors import DaemonError

    summary = summary_of(replay, runs)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_summary(out, summary)
    for problem in summary["problems"]:
        typer.echo(f"warning: {problem}", err=True)
    if not runs:
        reason = replay.failures[0].error if replay.failures else "it contains no pairs"
        raise DaemonError(f"{replay.take.path}: no cloud was reconstructed: {reason}")
    for failure in replay.failures:
        typer.echo(f"warning: pair {failure.sequence}: {failure.error}", err=True)
    location = f" in {out}" if out is not None else ""
    rate, sets = summary["pairs_per_second"], summary.get("sets")
    if sets is not None:
        lost = summary["sets_incomplete"]
        incomplete = f", {lost} incomplete sets" if lost else ""
        typer.echo(
            f"{summary['clouds']} clouds of {sets} sets ({summary['mode']}){location}, {rate:.2f} per "
            f"second{incomplete}"
        )
    else:
        typer.echo(f"{summary['clouds']} clouds of {summary['pairs']} pairs{location}, {rate:.2f} pairs per second")
    typer.echo("ms by stage: " + ", ".join(f"{name} {ms:.2f}" for name, ms in summary["ms"].items()))


def _bless(path: Path, figures: list[PairStatistics], replay: Replay) -> None:
    from daemon.apps.replay import golden

    about = {
        "take": replay.take.path.name,
        "session": replay.take.metadata.get("session"),
        "calibration": replay.calibration_file.identity,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    golden.bless(path, figures, about)
    typer.echo(f"{path}: {len(figures)} pairs written")


def _matches(expected: Golden, figures: list[PairStatistics]) -> bool:
    from daemon.apps.replay.compare import compare

    deviations = compare(expected, figures)
    if not deviations:
        typer.echo(f"as expected: {len(figures)} pairs within the tolerances")
        return True
    _print_deviations(deviations)
    return False


def _print_deviations(deviations: list[Deviation]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title="Deviations")
    for column in ("pair", "quantity", "expected", "actual", "tolerance"):
        table.add_column(column, overflow="fold")
    for deviation in deviations:
        table.add_row(
            str(deviation.sequence), deviation.quantity, deviation.expected, deviation.actual, deviation.limit
        )
    Console(highlight=False, markup=False).print(table)
