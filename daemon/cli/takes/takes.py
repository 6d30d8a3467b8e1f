"""``fringed takes``: the takes of a directory: list, show, check, repair, remove."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from daemon.recording.read.catalog import Listing, TakeEntry

_LONG_BYTES = 100_000_000  # smaller takes are read without a progress bar

app = typer.Typer(add_completion=False, rich_markup_mode=None)

DirOption = Annotated[Path | None, typer.Option("--dir", help="Directory of the takes.")]
RigOption = Annotated[Path | None, typer.Option(help="Take the directory from this rig.yaml.")]
Name = Annotated[str, typer.Argument(help="Name of the take, or its beginning.")]
AsJson = Annotated[bool, typer.Option("--json", help="Print plain JSON.")]


@app.callback(invoke_without_command=True)
def _root(context: typer.Context, directory: DirOption = None, rig: RigOption = None) -> None:
    """The takes of a directory: list (the default), show, check, repair, rm."""
    context.obj = (directory, rig)
    if context.invoked_subcommand is None:
        list_(context)


@app.command("list")
def list_(context: typer.Context, directory: DirOption = None, rig: RigOption = None, as_json: AsJson = False) -> None:
    """List every take: date, duration, size and state. The images are not read."""
    import json

    folder, listing = _scanned(context, directory, rig)
    if as_json:
        takes = [take.as_dict() for take in listing.takes]
        typer.echo(json.dumps({"directory": str(folder), "takes": takes, "garbage": listing.other_files}, indent=2))
        return
    _print(("take", "start", "duration", "pairs", "files", "size", "state"), map(row, listing.takes))
    for name, problem in listing.other_files.items():
        typer.echo(f"{folder / name}: no take: {problem}", err=True)


@app.command()
def show(
    context: typer.Context,
    name: Name,
    directory: DirOption = None,
    rig: RigOption = None,
    as_json: AsJson = False,
) -> None:
    """Show one take and its files; exit status 1 if it is damaged or incomplete."""
    import json

    folder, listing = _scanned(context, directory, rig)
    take = listing.find(name)
    if as_json:
        typer.echo(json.dumps(take.as_dict(), indent=2))
    else:
        _print(("", ""), details(folder, take))
    if take.problems:
        raise typer.Exit(1)


@app.command()
def check(
    context: typer.Context,
    names: Annotated[list[str] | None, typer.Argument(help="Takes; all without a name.")] = None,
    directory: DirOption = None,
    rig: RigOption = None,
) -> None:
    """Read every image of takes and verify its checksum; exit status 1 for errors."""
    folder, listing = _scanned(context, directory, rig)
    takes = [listing.find(name) for name in names] if names else listing.takes
    good = [_checked(folder, take) for take in takes]
    invalid = {} if names else listing.other_files
    for name, problem in invalid.items():
        typer.echo(f"{folder / name}: no take: {problem}", err=True)
    if invalid or not all(good):
        raise typer.Exit(1)


@app.command()
def repair(context: typer.Context, name: Name, directory: DirOption = None, rig: RigOption = None) -> None:
    """Repair truncated or damaged files of a take; the originals are kept as *.broken."""
    from daemon.cli.options.progress import rendering
    from daemon.recording.repair import repair as repair_file

    folder, listing = _scanned(context, directory, rig)
    for file in listing.find(name).files:
        with rendering(f"Reading {file}") as progress:
            long = (folder / file).stat().st_size > _LONG_BYTES
            repaired = repair_file(folder / file, progress if long else None)
        if repaired is None:
            typer.echo(f"{folder / file}: complete")
        else:
            typer.echo(
                f"{repaired.file}: {repaired.frames} frames kept; original: {repaired.kept} "
                f"({'; '.join(repaired.problems)})"
            )


@app.command()
def rm(
    context: typer.Context,
    name: Name,
    directory: DirOption = None,
    rig: RigOption = None,
    yes: Annotated[bool, typer.Option("--yes", help="Remove without confirmation.")] = False,
) -> None:
    """Remove a take with all its files, after confirmation."""
    from daemon.recording.format.errors import TakeError
    from daemon.recording.format.file_lock import being_written

    folder, listing = _scanned(context, directory, rig)
    take = listing.find(name)
    if any(being_written(folder / file) for file in take.files):
        raise TakeError(f"{take.name}: it is being written; stop the recording first")
    if not yes and not typer.confirm(f"Remove {len(take.files)} file(s), {take.bytes / 1e6:.1f} MB, of {take.name}?"):
        raise typer.Exit(1)
    for file in take.files:
        (folder / file).unlink(missing_ok=True)
    typer.echo(f"removed: {', '.join(take.files)}")


def _scanned(context: typer.Context, directory: Path | None, rig: Path | None) -> tuple[Path, Listing]:
    from daemon.recording.format.errors import TakeError
    from daemon.recording.read.catalog import scan

    outer: tuple[Path | None, Path | None] = context.obj or (None, None)
    folder = _directory(directory or outer[0], rig or outer[1])
    if not folder.is_dir():
        raise TakeError(f"{folder}: the directory does not exist; give it with --dir, or the rig's with --rig rig.yaml")
    return folder, scan(folder)


def _directory(directory: Path | None, rig: Path | None) -> Path:
    """The given directory, that of the rig file, or ``takes``."""
    if directory is not None:
        return directory
    if rig is None:
        return Path("takes")
    from daemon.config import load_rig

    config = load_rig(rig)
    return config.path(config.recording.dir, rig.resolve().parent)


def _checked(folder: Path, take: TakeEntry) -> bool:
    """Read a take, print its problems, and return whether it has none."""
    from daemon.recording.read.inspect import inspect
    from daemon.recording.read.take_reader import TakeReader

    if take.state == "writing":
        typer.echo(f"{take.name}: being written, not checked")
        return True
    with TakeReader(folder / f"{take.name}.mcap" if len(take.files) > 1 else folder / take.files[0]) as reader:
        report = inspect(reader)
    problems = report["problems"] + report["attachment_problems"]
    for problem in problems:
        typer.echo(problem, err=True)
    verdict = f"{len(problems)} problem(s)" if problems else "good"
    typer.echo(f"{take.name}: {verdict}, {report['pairs']} pairs, {report['missing']} triggers missing")
    return not problems


def row(take: TakeEntry) -> tuple[str, ...]:
    """A take as a row of the table."""
    note = f", interrupted {take.interruptions}x" if take.interruptions else ""
    return (
        take.name,
        _when(take.start_ns)[5:16],  # the name contains the year
        f"{take.duration_s:.1f} s",
        str(min(take.frames)),
        str(len(take.files)),
        f"{take.bytes / 1e6:.1f} MB",
        take.state + note,
    )


def details(folder: Path, take: TakeEntry) -> Iterator[tuple[str, str]]:
    """A take as rows of name and value."""
    yield "take", take.name
    yield "state", take.state
    yield "session", f"{take.session}, device {take.device}"
    yield "start", f"{_when(take.start_ns)}, {take.duration_s:.2f} s"
    yield "frames", f"left {take.frames[0]}, right {take.frames[1]}"
    yield "size", f"{take.bytes / 1e6:.1f} MB, {take.interruptions} interruption(s)"
    for file in take.files:
        yield "file", str(folder / file)
    for problem in take.problems:
        yield "problem", problem


def _when(t_ns: int) -> str:
    return datetime.fromtimestamp(t_ns / 1e9).astimezone().strftime("%Y-%m-%d %H:%M:%S") if t_ns else "     unknown"


def _print(header: tuple[str, ...], rows: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(show_header=any(header), box=None, pad_edge=False, header_style="bold")
    for i, name in enumerate(header):
        table.add_column(name, overflow="fold", no_wrap=i < len(header) - 1)
    for cells in rows:
        table.add_row(*cells)
    Console(highlight=False, markup=False).print(table)
