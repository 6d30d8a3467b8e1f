"""``fringed reprocess``: reconstruct many recordings, on all processors or on a cluster."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, cast, get_args

import typer

from daemon.cli.options.parts_option import PartsOption, chosen_parts

if TYPE_CHECKING:
    from daemon.apps.reprocess.engine.tasks import Engine
    from daemon.apps.reprocess.job import Job
    from daemon.apps.reprocess.plan.recordings import Recording
    from daemon.apps.reprocess.report.totals import Totals

app = typer.Typer(add_completion=False, rich_markup_mode=None)
_SHOWN = 20


@app.command()
def main(
    sources: Annotated[list[str], typer.Argument(help="Takes: files, folders, patterns, as paths or URLs.")],
    out: Annotated[str, typer.Option(help="Destination: a folder, or a URL such as s3://BUCKET/FOLDER.")],
    kind: Annotated[str, typer.Option("--format", help="Kind of cloud files: npz, ply, pcd, zarr, none.")] = "npz",
    parts: PartsOption = None,
    calibration: Annotated[Path | None, typer.Option(help="Use this calibration instead of the attached ones.")] = None,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", help="Change a setting: key=value, or compare: key=1,2,3. May be repeated."),
    ] = None,
    use_prior: Annotated[bool, typer.Option("--follow", help="Use the previous pair as temporal prior.")] = False,
    calibration_check: Annotated[
        str, typer.Option(help="Pairs that contradict the calibration: withhold their points, warn, or off.")
    ] = "withhold",
    temporal: Annotated[
        Literal["off", "fuse"], typer.Option(help="Average clouds where the scene is at rest.")
    ] = "off",
    scheduler: Annotated[str | None, typer.Option(help="Use a running Dask cluster: tcp://HOST:8786.")] = None,
    workers: Annotated[
        int | None, typer.Option(min=0, max=1024, help="Worker processes here; 0 = none, all in this process.")
    ] = None,
    memory_limit: Annotated[str, typer.Option(help="Memory of each worker here, such as 4GiB.")] = "auto",
    chunk: Annotated[int, typer.Option(min=1, max=100_000, help="Pairs in a task.")] = 16,
    sample: Annotated[
        int, typer.Option(min=1, help="Pairs to compare settings with, if --set has several values.")
    ] = 32,
    retry_failed: Annotated[
        bool, typer.Option("--retry-failed", help="Do what failed in an earlier run again.")
    ] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only report pairs, bytes and estimated time.")] = False,
) -> None:
    """Reconstruct many recordings.

    The clouds are bit for bit those of `fringed replay`, for any number of workers and any --chunk; with --temporal
    fuse a recording is one task. Run again, the command does only what is missing or would differ. Exit status 1:
    something has no result, see the list and report.html.
    """
    from daemon.apps.reprocess.destination.lock import locked
    from daemon.apps.reprocess.job import CLOUD_KINDS, Job
    from daemon.apps.reprocess.locations import location
    from daemon.apps.reprocess.plan.recordings import recordings_of
    from daemon.apps.reprocess.settings_grid import combinations
    from daemon.cli.options.set_option import parsed_settings, parsed_values
    from daemon.cli.takes.reprocess_compare import compare
    from daemon.common.errors import InputError
    from daemon.common.files import read_at_most
    from daemon.rig.calibration_file import SIZE_LIMIT, parse_calibration
    from pipeline.monitor.check.checked_reconstructor import Policy

    if kind not in (*CLOUD_KINDS, "none"):
        raise InputError(f"unknown cloud format {kind!r}, expected one of: {', '.join(CLOUD_KINDS)}, none")
    if calibration_check not in get_args(Policy):
        raise InputError(
            f"--calibration-check is {calibration_check!r}, expected one of: {', '.join(get_args(Policy))}"
        )
    if scheduler is not None and workers is not None:
        raise InputError("--workers starts processes here; with --scheduler start them by `fringed worker ADDRESS`")
    data = None if calibration is None else read_at_most(calibration, SIZE_LIMIT, InputError)
    if data is not None:
        parse_calibration(data, str(calibration))
    texts = set_ or []
    grid = [text for text in texts if "," in text]
    if grid and temporal == "fuse":
        raise InputError("--temporal fuse averages with all clouds before, and --set with several values samples pairs")
    settings = parsed_settings([text for text in texts if text not in grid])
    for changes in combinations(parsed_values(grid)):
        settings.with_overrides(changes)
    job = Job(
        settings, data, "" if kind == "none" else kind, cast(Policy, calibration_check), use_prior,
        chosen_parts(parts) or (), chunk, fuse=temporal == "fuse",
    )  # fmt: skip
    recordings = recordings_of(sources)
    count = len(os.sched_getaffinity(0)) if workers is None else workers
    if dry_run:
        _estimate(job, recordings, out, max(1, count))
        return
    if grid:
        with locked(location(out)), _engine(scheduler, count, memory_limit, recordings) as engine:
            compare(job, recordings, out, grid, sample, engine)
        return
    if _reprocess(job, recordings, out, scheduler, count, memory_limit, retry_failed=retry_failed):
        raise typer.Exit(1)


def _reprocess(
    job: Job,
    recordings: list[Recording],
    out: str,
    scheduler: str | None,
    workers: int,
    memory_limit: str,
    *,
    retry_failed: bool,
) -> bool:
    """Do it and report; returns whether something has no result."""
    from daemon.apps.reprocess.destination.lock import locked
    from daemon.apps.reprocess.locations import location
    from daemon.apps.reprocess.report.write import write_report
    from daemon.apps.reprocess.run import Run
    from daemon.cli.takes.reprocess_progress import shown

    root = location(out)
    with locked(root), _engine(scheduler, workers, memory_limit, recordings) as engine:
        with shown() as show:
            run = Run(job, root, engine, retry_failed=retry_failed, observe=show)
            totals = run.run(recordings)
        page = write_report(root, job, totals, seconds=run.seconds)
    _print(totals, run.seconds, str(page))
    return bool(totals.failures)


@contextmanager
def _engine(scheduler: str | None, workers: int, memory_limit: str, recordings: list[Recording]) -> Iterator[Engine]:
    from daemon.apps.reprocess.engine.dask_engine import connected, local_cluster
    from daemon.apps.reprocess.engine.tasks import InlineEngine
    from daemon.cli.allocator import worker_environment

    if scheduler is None:
        _compile(recordings)
    if scheduler is None and workers == 0:
        yield InlineEngine()
        return
    cluster = (
        local_cluster(workers, worker_environment(1), memory_limit=memory_limit)
        if scheduler is None
        else connected(scheduler)
    )
    with cluster as engine:
        typer.echo(f"{engine.slots} workers; dashboard: {engine.dashboard}", err=True)
        yield engine


def _compile(recordings: list[Recording]) -> None:
    """Compile the kernels of the first recording that can be read, once for all workers of this machine."""
    from daemon.apps.reprocess.locations import location
    from daemon.cli.options.progress import rendering
    from daemon.common.errors import DaemonError
    from daemon.kernels.jobs import measuring_jobs
    from daemon.kernels.processes import compile_kernels
    from daemon.recording.read.take_reader import TakeReader
    from pipeline.common.errors import PipelineError

    for recording in recordings:
        try:
            with TakeReader(location(recording.url)) as take:
                sequence, pair = take.sequence(), next(take.pairs(), None)
        except (DaemonError, PipelineError, OSError):
            continue  # its own task reports it
        if pair is not None:
            with rendering("Compiling the kernels") as show:
                jobs = measuring_jobs(pair.encoding, None if sequence is None else sequence.name)
                compile_kernels(jobs, lambda progress: show(*progress) if progress.done < progress.total else None)
            return


def _estimate(job: Job, recordings: list[Recording], out: str, workers: int) -> None:
    from daemon.apps.reprocess.dry_run import estimate

    found = estimate(job, recordings, out, workers)
    for problem in found.problems:
        typer.echo(f"warning: {problem}", err=True)
    typer.echo(
        f"{found.items} pairs or sets in {len(recordings)} recordings, {found.bytes / 1e9:.2f} GB; "
        f"{found.left} of them to do"
    )
    if found.item_s:
        typer.echo(
            f"{found.item_s * 1000:.0f} ms each by one thread: about {found.seconds:.0f} s with {workers} workers "
            "as fast as this machine's processors"
        )


def _print(totals: Totals, seconds: float, page: str) -> None:
    means = totals.sums.means()
    rate = totals.computed / seconds if seconds > 0 else 0.0
    typer.echo(
        f"{totals.done} of {totals.items} pairs of {totals.recordings} recordings done, "
        f"{totals.done - totals.computed} of them before; {rate:.2f} pairs per second"
    )
    typer.echo(f"mean coverage {means['coverage']:.3f}, {means['points']:.0f} points; report: {page}")
    for take in totals.closed:
        for problem in take.problems[:2]:
            typer.echo(f"warning: {problem}", err=True)
    failures = totals.failures
    for failure in failures[:_SHOWN]:
        typer.echo(f"failed: {failure}", err=True)
    if len(failures) > _SHOWN:
        typer.echo(f"and {len(failures) - _SHOWN} more, see the report", err=True)
    if failures:
        typer.echo("--retry-failed does these again", err=True)
